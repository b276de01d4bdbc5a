//! What is logged, by how often `-v` was given, or by `RUST_LOG`.
//!
//! Zenoh writes its whole configuration at the level debug when a session opens, and the password is in it. Those lines are never
//! written, whatever was asked for.

use tracing_subscriber::EnvFilter;

/// Where Zenoh writes its configuration, and the most that is let through from there.
const CONFIGURATION: &str = "zenoh::api::session=info";

/// What passes: `RUST_LOG`, or the level of this many `-v`.
pub fn filter(verbose: u8) -> EnvFilter {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(directives(verbose)));
    filter.add_directive(CONFIGURATION.parse().expect("a directive, see the tests"))
}

fn directives(verbose: u8) -> &'static str {
    match verbose {
        0 => "warn,zenoh=error",
        1 => "warn,zenoh=error,domvs=info",
        2 => "info,domvs=debug",
        _ => "trace",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_keeps_zenohs_configuration_out() {
        for verbose in 0..4 {
            assert!(filter(verbose).to_string().contains(CONFIGURATION), "{verbose}");
        }
    }
}
