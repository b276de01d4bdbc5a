//! What `domvs twist` says: one JSON object, or a small table.

use comfy_table::{Cell, CellAlignment, Table};
use domvs_proto::settings::Method;
use domvs_vision::{Step, WindowInUse};
use serde::Serialize;

use super::TwistArgs;
use super::inputs::{Inputs, Seen, size};
use crate::paint::Paint;

/// The answer; its fields are the keys of the JSON object. A number that is not finite becomes null.
#[derive(Debug, Serialize)]
pub struct Answer {
    pub twist: [f64; 6],
    pub order: usize,
    pub window: Option<Vec<f64>>,
    pub pixel_mse: f64,
    pub feature_error_squared: f64,
    pub features: usize,
    pub condition_number: f64,
    pub status: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light: Option<[f64; 6]>,
}

impl Answer {
    /// The part of `step` that users ask for.
    pub fn new(step: &Step) -> Answer {
        Answer {
            twist: step.twist.to_array(),
            order: step.order,
            window: window_numbers(&step.window),
            pixel_mse: step.pixel_mse,
            feature_error_squared: step.feature_error_squared,
            features: step.features,
            condition_number: step.condition_number,
            status: if step.rank_deficient { "rank_deficient" } else { "servoing" },
            light: step.light,
        }
    }

    /// The answer for people: the twist, what stands behind it, what was read.
    pub fn text(&self, args: &TwistArgs, inputs: &Inputs, paint: Paint) -> String {
        let status = match self.status {
            "servoing" => paint.good(self.status),
            other => paint.bad(other),
        };
        let mut lines = vec![
            ("status", status),
            ("method", self.method_text(args, &inputs.desired)),
            ("gain", format!("{} 1/s", args.gain)),
            ("pixel error", format!("{:.6e}", self.pixel_mse)),
            ("e·e", format!("{:.6}", self.feature_error_squared)),
            ("condition of L", format!("{:.1}", self.condition_number)),
        ];
        for (role, seen) in [("desired", &inputs.desired), ("current", &inputs.current)] {
            lines.push((role, format!("{}, {}; depth {}", seen.name, size(&seen.plane), seen.depth_note)));
        }
        lines.extend(inputs.initial.iter().map(|initial| ("initial", initial.name.clone())));
        lines.extend(inputs.mask.iter().map(|mask| ("mask", mask.name.clone())));
        lines.extend(self.light.map(|light| ("light", light_text(light))));
        let lines: Vec<String> = lines.iter().map(|(name, value)| format!("{name:<16} {value}")).collect();
        format!("{}\n{}", self.table(paint), lines.join("\n"))
    }

    fn table(&self, paint: Paint) -> Table {
        let [vx, vy, vz, wx, wy, wz] = self.twist;
        let mut table = paint.table(&["camera twist", "x right", "y down", "z forward", "unit"]);
        for (name, values, unit) in [("linear", [vx, vy, vz], "m/s"), ("angular", [wx, wy, wz], "rad/s")] {
            let mut cells = vec![Cell::new(name)];
            let right = |value| Cell::new(format!("{value:.6}")).set_alignment(CellAlignment::Right);
            cells.extend(values.map(right));
            cells.push(Cell::new(unit));
            table.add_row(cells);
        }
        table
    }

    fn method_text(&self, args: &TwistArgs, desired: &Seen) -> String {
        let (word, features) = (args.features.method, self.features);
        match (args.features.method.0, self.window.as_deref()) {
            (Method::Photometric, _) => format!("{word}, {features} features"),
            (Method::GaussianMixture, _) => {
                let extent_px = args.features.gaussian_px(&desired.plane);
                format!("{word}, blurred by {extent_px} px, {features} features")
            }
            (_, window) => format!("{word}, order {}, {features} features{}", self.order, window_text(window)),
        }
    }
}

fn light_text([gain, offset, slopes @ ..]: [f64; 6]) -> String {
    let [gain_u, gain_v, offset_u, offset_v] = slopes;
    format!("gain {gain:+.4}, offset {offset:+.4}; slopes {gain_u:+.4},{gain_v:+.4} and {offset_u:+.4},{offset_v:+.4}")
}

fn window_text(window: Option<&[f64]>) -> String {
    match window {
        Some([ax, bx, ay, by]) => format!(", window a,b = {ax},{bx} along x, {ay},{by} along y"),
        Some([px, py]) => format!(", centred at {px:.4},{py:.4} of the image"),
        _ => String::new(),
    }
}

/// Hahn: ax, bx, ay, by; Krawtchouk: p_x, p_y; otherwise nothing.
fn window_numbers(window: &WindowInUse) -> Option<Vec<f64>> {
    match *window {
        WindowInUse::Whole => None,
        WindowInUse::Hahn { x, y } => Some([x, y].concat()),
        WindowInUse::Krawtchouk { p } => Some(p.to_vec()),
    }
}
