//! Zenoh sessions that a command opens for itself.

use std::net::TcpListener;

use anyhow::{Context, anyhow};
use domvs_client::LEASE_MS;
use serde_json::{Value, json};
use zenoh::{Config, Session};

/// Another process may take a free port before the router does; then another one is tried.
const ATTEMPTS: usize = 5;

/// The configuration of a router that listens on `endpoints`: no scouting, a lease of one second.
///
/// # Errors
/// Fails when an endpoint is not one.
pub fn router_config(endpoints: &[String]) -> anyhow::Result<Config> {
    let mut config = Config::default();
    let entries: [(&str, Value); 6] = [
        ("mode", json!("router")),
        ("listen/endpoints", json!(endpoints)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("scouting/delay", json!(0)),
        ("transport/link/tx/lease", json!(LEASE_MS)),
    ];
    for (key, value) in entries {
        let value = value.to_string();
        config.insert_json5(key, &value).map_err(|error| anyhow!("unusable Zenoh setting {key} = {value}: {error}"))?;
    }
    Ok(config)
}

/// A router on a free loopback port, and its endpoint.
///
/// # Errors
/// Fails when no port can be taken in a few attempts.
pub async fn open_local_router() -> anyhow::Result<(Session, String)> {
    let mut last = anyhow!("not tried");
    for _ in 0..ATTEMPTS {
        let port = TcpListener::bind(("127.0.0.1", 0)).and_then(|listener| listener.local_addr());
        let endpoint = format!("tcp/{}", port.context("no loopback port is free")?);
        match zenoh::open(router_config(std::slice::from_ref(&endpoint))?).await {
            Ok(router) => return Ok((router, endpoint)),
            Err(error) => last = anyhow::Error::from_boxed(error),
        }
    }
    Err(last.context("cannot open a router on the loopback"))
}

/// Returns when Ctrl-C or SIGTERM comes.
///
/// # Errors
/// Fails when the system gives no signals.
pub async fn interrupted() -> anyhow::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        _ = terminate.recv() => Ok(()),
        interrupt = tokio::signal::ctrl_c() => Ok(interrupt?),
    }
}

/// A client name for a command that only asks something and goes.
pub fn passing_name() -> String {
    format!("cli-{}", std::process::id())
}
