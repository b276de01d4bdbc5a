//! What a worker asks of its Zenoh session: no answer waits for a client that does not read, and no message is put together that is larger
//! than any it takes.
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

/// The largest message that is put together from its pieces, whoever sends them: Zenoh's own gigabyte would be taken before anything is looked at.
const LARGEST: &str = "transport/link/rx/max_message_size";
/// What a message has besides its payload: attachment, key, Encoding.
const BESIDE_PAYLOAD: u64 = 1 << 20;
/// Not less than this, as in the files of `deploy/zenoh`: who sends a little too much is told so by the worker, in words.
const LEAST_LARGEST: u64 = 65 << 20;

/// Adds the rule to a configuration, unless it is there, and room and time for answers, unless it has more; bounds messages by the largest
/// payload that the worker takes, unless they are bounded more tightly.
///
/// Fails with Zenoh's sentence when `qos/network` is not what Zenoh takes.
pub fn prepared(mut config: Config, bytes_per_payload: usize) -> zenoh::Result<Config> {
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
    let most = (bytes_per_payload as u64).saturating_add(BESIDE_PAYLOAD).max(LEAST_LARGEST);
    if serde_json::from_str::<u64>(&config.get_json(LARGEST)?)? > most {
        config.insert_json5(LARGEST, &most.to_string())?;
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
        let once = prepared(config, 100 << 20).expect("valid");
        let ids: Vec<_> = rules(&once).iter().map(|rule| rule["id"].clone()).collect();
        assert_eq!(ids, ["mine", RULE]);
        let twice = prepared(once.clone(), 200 << 20).expect("valid");
        assert_eq!(rules(&twice), rules(&once));
        assert_eq!(rules(&once)[1]["overwrite"]["congestion_control"], "drop");
        assert_eq!(once.get_json(WAIT).expect("it is there"), WAIT_US.to_string());
        for bounded in [&once, &twice] {
            assert_eq!(bounded.get_json(LARGEST).expect("it is there"), (101_u64 << 20).to_string());
        }
        assert_eq!(once.get_json(TWIST_QUEUE).expect("it is there"), TWISTS.to_string());
    }
}
