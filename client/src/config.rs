//! How a Domvs process joins Zenoh: a file, endpoints, and a few settings that the service rests on.
//!
//! Without a file: client mode, no multicast or gossip scouting (only the endpoints named are contacted), a lease of one second
//! (a hung peer is noticed after it), attempts at least every second to find a lost router again, and patience with frames of many
//! network packets on slow links.

use std::path::Path;

use serde_json::{Value, json};
use zenoh::Config;

use crate::ClientError;
use crate::error::zenoh_says;

/// Where a router or worker is expected when nothing else is said.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How long a silent link is trusted, in milliseconds; both ends of a link should agree.
pub const LEASE_MS: u64 = 1000;

/// The pause before the first attempt to find a lost router again, and the longest between two attempts, in milliseconds:
/// an arm stands still meanwhile. Zenoh's own are 1000 and 4000.
const RETRY_MS: (u64, u64) = (100, 1000);

/// A handshake that takes longer than this is tried anew, in milliseconds; Zenoh's own is 10 s.
const OPEN_TIMEOUT_MS: u64 = 2000;

/// How long a frame of many fragments may wait for room on a congested link before it is dropped, in microseconds.
const FRAGMENT_WAIT_US: u64 = 200_000;

/// The Zenoh configuration of a client.
///
/// A file is taken as it is, but that a router which scouts nobody does not wait for anybody either; `endpoints` (like `tcp/192.168.1.5:7447`), when there are any, replace those in it.
/// Without a file the built-in settings apply, and without an endpoint either, [`DEFAULT_ENDPOINT`].
///
/// # Errors
/// [`ClientError::Config`] when the file cannot be read or an endpoint is not one.
pub fn zenoh_config(file: Option<&Path>, endpoints: &[String]) -> Result<Config, ClientError> {
    match file {
        Some(file) => {
            let mut config = Config::from_file(file)
                .map_err(|error| ClientError::Config { what: file.display().to_string(), error: zenoh_says(&error) })?;
            if !endpoints.is_empty() {
                insert(&mut config, "connect/endpoints", json!(endpoints))?;
            }
            if is_idle_wait(&config) {
                insert(&mut config, "scouting/delay", json!(0))?;
            }
            Ok(config)
        }
        None if endpoints.is_empty() => built_in(&[DEFAULT_ENDPOINT.to_string()]),
        None => built_in(endpoints),
    }
}

/// Whether Zenoh would spend its scouting delay on nothing: a router's half second, when the file neither names one nor scouts.
fn is_idle_wait(config: &Config) -> bool {
    let is = |key: &str, json: &str| config.get_json(key).is_ok_and(|text| text == json);
    is("mode", r#""router""#) && is("scouting/multicast/enabled", "false") && is("scouting/delay", "null")
}

fn built_in(endpoints: &[String]) -> Result<Config, ClientError> {
    let mut config = Config::default();
    insert(&mut config, "mode", json!("client"))?;
    insert(&mut config, "connect/endpoints", json!(endpoints))?;
    insert(&mut config, "scouting/multicast/enabled", json!(false))?;
    insert(&mut config, "scouting/gossip/enabled", json!(false))?;
    insert(&mut config, "transport/link/tx/lease", json!(LEASE_MS))?;
    insert(&mut config, "transport/unicast/open_timeout", json!(OPEN_TIMEOUT_MS))?;
    let retry = json!({ "period_init_ms": RETRY_MS.0, "period_max_ms": RETRY_MS.1, "period_increase_factor": 2 });
    insert(&mut config, "connect/retry", retry)?;
    insert(
        &mut config,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
        json!(FRAGMENT_WAIT_US),
    )?;
    Ok(config)
}

fn insert(config: &mut Config, key: &str, value: Value) -> Result<(), ClientError> {
    let value = value.to_string();
    config
        .insert_json5(key, &value)
        .map_err(|error| ClientError::Config { what: format!("{key} = {value}"), error: zenoh_says(&error) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting(config: &Config, key: &str) -> Value {
        serde_json::from_str(&config.get_json(key).expect("the key exists")).expect("settings are JSON")
    }

    #[test]
    fn without_a_file_only_the_named_endpoints_are_contacted() {
        let config = zenoh_config(None, &["tcp/127.0.0.1:9".into()]).expect("valid");
        assert_eq!(setting(&config, "connect/endpoints"), json!(["tcp/127.0.0.1:9"]));
        assert_eq!(setting(&config, "mode"), json!("client"));
        assert_eq!(setting(&config, "scouting/multicast/enabled"), json!(false));
        assert_eq!(setting(&config, "transport/link/tx/lease"), json!(LEASE_MS));
        let retry = setting(&config, "connect/retry");
        assert_eq!((&retry["period_init_ms"], &retry["period_max_ms"]), (&json!(RETRY_MS.0), &json!(RETRY_MS.1)));
    }

    #[test]
    fn without_anything_the_local_router_is_meant() {
        let config = zenoh_config(None, &[]).expect("valid");
        assert_eq!(setting(&config, "connect/endpoints"), json!([DEFAULT_ENDPOINT]));
    }

    #[test]
    fn a_router_that_scouts_nobody_waits_for_nobody() {
        let delay = |json5: &str| {
            let file = std::env::temp_dir().join(format!("domvs-config-{}.json5", std::process::id()));
            std::fs::write(&file, json5).expect("a writable folder");
            let config = zenoh_config(Some(&file), &[]).expect("valid");
            std::fs::remove_file(&file).expect("it was there");
            setting(&config, "scouting/delay")
        };
        assert_eq!(delay(r#"{ mode: "router", scouting: { multicast: { enabled: false } } }"#), json!(0));
        assert_eq!(delay(r#"{ mode: "router", scouting: { delay: 70, multicast: { enabled: false } } }"#), json!(70));
        assert_eq!(delay(r#"{ mode: "router" }"#), Value::Null);
    }

    #[test]
    fn an_endpoint_that_is_none_is_named_in_the_error() {
        let error = zenoh_config(None, &["not an endpoint".into()]).expect_err("refused");
        assert!(error.to_string().contains("not an endpoint"), "{error}");
    }

    #[test]
    fn a_missing_file_is_named_in_the_error() {
        let error = zenoh_config(Some(Path::new("no/such/file.json5")), &[]).expect_err("refused");
        assert!(error.to_string().contains("no/such/file.json5"), "{error}");
    }
}
