//! The running service over real Zenoh sessions: a worker, its clients and its cameras, each in a session of its own, joined
//! by a router on a loopback port that the system chose. Every test has a router and a worker to itself.
//!
//! No test sleeps and none measures speed. Waits are on a condition with a limit; the one time that is asserted is the
//! watchdog's, with a slack that is stated.

#[macro_use]
mod support;

mod architecture;
mod clients;
mod formats;
mod fuzz;
mod hostile;
mod life;
mod load;
mod logs;
mod methods;
mod metrics;
mod pictures;
mod pushed;
mod recording;
mod replicas;
mod requests;
mod security;
mod settings;
mod tenancy;
