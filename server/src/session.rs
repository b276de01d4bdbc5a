//! The one thing that a worker asks of its Zenoh session: no answer waits for a client that does not read.
//!
//! A reply goes out as its query came in, and queries come in with congestion control Block: towards a client that has stopped
//! reading, Zenoh would hold the thread, and the router's with it, for up to five seconds, and everybody's answers behind it. So the
//! session takes every query as one with Drop: an answer that finds no room is lost, and its client, which sees silence, brakes.

use serde_json::{Value, json};
use zenoh::Config;

/// Name of the rule among others in `qos/network`.
const RULE: &str = "domvs-answers-never-wait";

/// What an answer may wait for room before it is lost, µs: longer than a router holds a link up for a client that takes large answers
/// and does not read them (50 ms), and far shorter than Zenoh's five seconds. Its own millisecond loses answers whenever the
/// processor is busy elsewhere.
const WAIT_US: u64 = 100_000;
const WAIT: &str = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";
/// Twists are sent at once, each in a batch of its own, so that two batches, as Zenoh has them, are two twists.
const TWISTS: u64 = 16;
const TWIST_QUEUE: &str = "transport/link/tx/queue/size/real_time";

/// Adds the rule to a configuration, unless it is there, and room and time for answers, unless it has more.
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
    for (entry, least) in [(WAIT, WAIT_US), (TWIST_QUEUE, TWISTS)] {
        let there: u64 = serde_json::from_str(&config.get_json(entry)?)?;
        if there < least {
            config.insert_json5(entry, &least.to_string())?;
        }
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
        assert_eq!(once.get_json(WAIT).expect("it is there"), WAIT_US.to_string());
        assert_eq!(once.get_json(TWIST_QUEUE).expect("it is there"), TWISTS.to_string());
    }
}
