//! What `domvs twist` says: one JSON object, or a small table.

use comfy_table::{Cell, CellAlignment};
use domvs_vision::{Step, WindowInUse};
use serde::Serialize;

use super::inputs::{Inputs, size};
use crate::options::MethodOption;
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
            status: if step.rank_deficient {
                "rank_deficient"
            } else {
                "servoing"
            },
        }
    }

    /// The answer for people: what was read, the twist, what stands behind it.
    pub fn text(&self, method: MethodOption, inputs: &Inputs, paint: Paint) -> String {
        let [vx, vy, vz, wx, wy, wz] = self.twist;
        let mut table = paint.table(&["camera twist", "x right", "y down", "z forward", "unit"]);
        for (name, values, unit) in [
            ("linear", [vx, vy, vz], "m/s"),
            ("angular", [wx, wy, wz], "rad/s"),
        ] {
            let mut cells = vec![Cell::new(name)];
            cells.extend(
                values.map(|value| {
                    Cell::new(format!("{value:.6}")).set_alignment(CellAlignment::Right)
                }),
            );
            cells.push(Cell::new(unit));
            table.add_row(cells);
        }
        let status = if self.status == "servoing" {
            paint.good(self.status)
        } else {
            paint.bad(self.status)
        };
        let mut lines = vec![
            format!("{:<16} {}", "status", status),
            format!(
                "{:<16} {method}, order {}, {} features{}",
                "method",
                self.order,
                self.features,
                self.window_text(method)
            ),
            format!("{:<16} {:.6e}", "pixel error", self.pixel_mse),
            format!("{:<16} {:.6}", "e·e", self.feature_error_squared),
            format!("{:<16} {:.1}", "condition of L", self.condition_number),
        ];
        for (role, seen) in [("desired", &inputs.desired), ("current", &inputs.current)] {
            lines.push(format!(
                "{role:<16} {}, {}; depth {}",
                seen.name,
                size(&seen.plane),
                seen.depth_note
            ));
        }
        if let Some(initial) = &inputs.initial {
            lines.push(format!("{:<16} {}", "initial", initial.name));
        }
        format!("{table}\n{}", lines.join("\n"))
    }

    fn window_text(&self, method: MethodOption) -> String {
        match (method, self.window.as_deref()) {
            (MethodOption::Hahn, Some([ax, bx, ay, by])) => {
                format!(", window a,b = {ax},{bx} along x, {ay},{by} along y")
            }
            (_, Some([px, py])) => format!(", centred at {px:.4},{py:.4} of the image"),
            _ => String::new(),
        }
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
