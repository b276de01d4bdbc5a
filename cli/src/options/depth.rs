//! `--depth map|M`: what the law is told about depth.

use std::fmt;
use std::str::FromStr;

use super::positive;

/// Where the law takes depth from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum DepthSource {
    /// Every frame brings its own map.
    #[default]
    Map,
    /// One number for every pixel, m.
    Constant(f64),
}

impl FromStr for DepthSource {
    type Err = String;

    fn from_str(text: &str) -> Result<DepthSource, String> {
        match text {
            "map" | "true" => Ok(DepthSource::Map),
            _ => positive(text).map(DepthSource::Constant).map_err(|_| format!("expected map or metres, got '{text}'")),
        }
    }
}

impl fmt::Display for DepthSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            DepthSource::Map => f.write_str("map"),
            DepthSource::Constant(depth_m) => write!(f, "{depth_m}"),
        }
    }
}
