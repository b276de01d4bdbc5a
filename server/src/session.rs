//! The one thing that a worker asks of its Zenoh session: no answer waits for a client that does not read.
//!
//! A reply goes out as its query came in, and queries come in with congestion control Block: towards a client that has stopped
//! reading, Zenoh would hold the thread, and the router's with it, for up to five seconds, and everybody's answers behind it. So the
//! session takes every query as one with Drop: an answer that finds no room is lost, and its client, which sees silence, brakes.

use serde_json::{Value, json};
use zenoh::Config;

/// Name of the rule among others in `qos/network`.
const RULE: &str = "domvs-answers-never-wait";

/// Adds the rule to a configuration, unless it is there, and leaves all else as it is.
///
/// Fails with Zenoh's sentence when `qos/network` is not what Zenoh takes.
pub fn prepared(mut config: Config) -> zenoh::Result<Config> {
    let there = config.get_json("qos/network")?;
    let mut rules: Vec<Value> = serde_json::from_str(&there)?;
    if !rules.iter().any(|rule| rule["id"] == RULE) {
        rules.push(json!({
            "id": RULE,
            "messages": ["query"],
            "flows": ["ingress"],
            "overwrite": { "congestion_control": "drop" },
        }));
        config.insert_json5("qos/network", &Value::from(rules).to_string())?;
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(config: &Config) -> Vec<Value> {
        serde_json::from_str(&config.get_json("qos/network").expect("it is there")).expect("a list")
    }

    #[test]
    fn the_rule_is_added_once_and_others_stay() {
        let mut config = Config::default();
        let other = r#"[{ id: "mine", messages: ["put"], overwrite: { priority: "data" } }]"#;
        config.insert_json5("qos/network", other).expect("a rule");
        let once = prepared(config).expect("valid");
        let ids: Vec<_> = rules(&once).iter().map(|rule| rule["id"].clone()).collect();
        assert_eq!(ids, ["mine", RULE]);
        let twice = prepared(once.clone()).expect("valid");
        assert_eq!(rules(&twice), rules(&once));
        assert_eq!(rules(&once)[1]["overwrite"]["congestion_control"], "drop");
    }
}
