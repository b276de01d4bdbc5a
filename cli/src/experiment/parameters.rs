//! The parameters a law uses on an image, for plots: Hahn's a and b, Krawtchouk's p. An answer on the wire does not carry them,
//! so they are computed again from the same images, by the law's own functions.

use domvs_proto::settings::{KrawtchoukP, Lattice, Method, TaskSettings, Window};
use domvs_vision::Plane;
use domvs_vision::family::hahn::{Rule, hahn_window};
use domvs_vision::family::krawtchouk::{self, krawtchouk_p};
use domvs_vision::window::Brightness;

/// Knows the desired image.
pub struct Parameters {
    kind: Kind,
    invert: bool,
    desired: Brightness,
}

enum Kind {
    Constant(Vec<f64>),
    Hahn(Rule),
    Krawtchouk(krawtchouk::Lattice),
}

impl Parameters {
    /// For a run towards `desired` under these settings.
    pub fn new(settings: &TaskSettings, desired: &Plane<f32>) -> Parameters {
        let kind = match (settings.method, settings.window, settings.krawtchouk.p) {
            (Method::Hahn, Window::Adaptive, _) => Kind::Hahn(Rule::Logs),
            (Method::Hahn, Window::AdaptivePaper, _) => Kind::Hahn(Rule::Paper),
            (Method::Hahn, Window::Fixed { a, b }, _) => Kind::Constant(vec![a[0], b[0], a[1], b[1]]),
            (Method::Krawtchouk, _, KrawtchoukP::Fixed(p)) => Kind::Constant(p.to_vec()),
            (Method::Krawtchouk, _, KrawtchoukP::Adaptive) => Kind::Krawtchouk(match settings.krawtchouk.lattice {
                Lattice::Paper => krawtchouk::Lattice::Paper,
                Lattice::Exact => krawtchouk::Lattice::Exact,
            }),
            _ => Kind::Constant(Vec::new()),
        };
        let invert = settings.preprocess.invert;
        Parameters { kind, invert, desired: brightness(desired, invert) }
    }

    /// Hahn: ax, bx, ay, by; Krawtchouk: p_x, p_y; otherwise, or where the image has none, nothing.
    pub fn of(&mut self, current: &Plane<f32>) -> Vec<f64> {
        let current = || brightness(current, self.invert);
        match &self.kind {
            Kind::Constant(parameters) => parameters.clone(),
            Kind::Hahn(rule) => {
                hahn_window(*rule, &current(), &self.desired).map_or_else(|_| Vec::new(), |window| window.concat())
            }
            Kind::Krawtchouk(lattice) => {
                krawtchouk_p(*lattice, &current(), &self.desired).map_or_else(|_| Vec::new(), |p| p.to_vec())
            }
        }
    }
}

fn brightness(image: &Plane<f32>, invert: bool) -> Brightness {
    if !invert {
        return Brightness::of(image);
    }
    Brightness::of(&Plane::from_fn(image.width(), image.height(), |u, v| 1.0 - image.at(u, v)))
}

#[cfg(test)]
mod tests {
    use domvs_proto::settings::Camera;
    use serde_json::json;

    use super::*;

    fn parameters(patch: serde_json::Value) -> Vec<f64> {
        let camera = Camera { fx: 60.0, fy: 60.0, cx: 31.5, cy: 31.5, width: 64, height: 64, distortion: None };
        let settings = TaskSettings::new(camera).merge_patch(&patch).expect("settings");
        let spot =
            |at: usize| Plane::from_fn(64, 64, |u, v| if u.abs_diff(at) + v.abs_diff(32) < 6 { 1.0 } else { 0.0 });
        Parameters::new(&settings, &spot(16)).of(&spot(24))
    }

    #[test]
    fn krawtchouk_follows_the_mean_centroid_and_hahn_leans_towards_it() {
        assert_eq!(parameters(json!({ "method": "krawtchouk" })), [20.0 / 64.0, 0.5]);
        let window = parameters(json!({ "window": "adaptive" }));
        assert!(window[0] > 1.5 * window[1] && window[2] == window[3], "{window:?}");
    }

    #[test]
    fn what_is_fixed_stays_and_what_has_none_has_none() {
        assert_eq!(parameters(json!({})), [8.0; 4]);
        assert_eq!(parameters(json!({ "method": "tchebichef" })), [0.0; 0]);
    }
}
