//! The table of settings: path, range and meaning of each. `validate` reads the ranges, the docs print them.

use self::Range::{Between, Words};
use super::{methods, patch};

/// What a setting may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// A number from the first to the second, both included.
    Between(f64, f64),
    /// Something else, in words.
    Words(&'static str),
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Between(least, most) => write!(f, "{least} to {most}"),
            Words(words) => f.write_str(words),
        }
    }
}

/// One setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Field {
    /// Its path in the JSON, with dots.
    pub name: &'static str,
    /// What it may be.
    pub range: Range,
    /// What it does.
    pub meaning: &'static str,
}

/// The field with this path, if it is a setting.
pub(super) fn find(name: &str) -> Option<&'static Field> {
    FIELDS.iter().find(|field| field.name == name)
}

/// All settings as a Markdown table: name, default, range, meaning.
pub fn table() -> String {
    let defaults = patch::defaults();
    let mut lines = vec!["| setting | default | range | meaning |".to_owned(), "|---|---|---|---|".to_owned()];
    for Field { name, range, meaning } in FIELDS {
        let path = format!("/{}", name.replace('.', "/"));
        let default = match defaults.pointer(&path) {
            // The parts of an object have rows of their own.
            Some(value) if value.is_object() => "`{…}`".to_owned(),
            Some(value) => format!("`{value}`"),
            None if name.starts_with("camera.") => "required".to_owned(),
            None => "–".to_owned(),
        };
        lines.push(format!("| `{name}` | {default} | {range} | {meaning} |"));
    }
    lines.join("\n")
}

const fn field(name: &'static str, range: Range, meaning: &'static str) -> Field {
    Field { name, range, meaning }
}

/// Every setting, in the order of the JSON.
pub const FIELDS: &[Field] = &[
    field("method", Words(methods::WORDS), "what is compared between the images"),
    field(
        "window",
        Words("`\"adaptive\"`, `\"adaptive_paper\"`, `{\"fixed\": {\"a\", \"b\"}}`"),
        "window of Hahn moments; ignored by the others",
    ),
    field("window.fixed.a", Between(0.0, 1e5), "Hahn's a; a number, or a pair [x, y]"),
    field("window.fixed.b", Between(0.0, 1e5), "Hahn's b; a number, or a pair [x, y]"),
    field(
        "krawtchouk.p",
        Words("`\"adaptive\"`, or 0.001 to 0.999; a number, or a pair [x, y]"),
        "place of the Krawtchouk window; ignored by the others",
    ),
    field("krawtchouk.lattice", Words("`paper`, `exact`"), "N + 1 points cut to N pixels, or N points"),
    field(
        "gaussian_px",
        Words("null, or 0.5 to 512"),
        "standard deviation of the Gaussian mixture's blur; null: camera.width / 8; ignored by the others",
    ),
    field(
        "order",
        Words("a number, or `{\"min\", \"max\"}`"),
        "largest moment order, fixed or adaptive; ignored by `photometric` and `gaussian_mixture`",
    ),
    field("order.min", Between(1.0, 40.0), "order far from the target; at most `order.max`"),
    field("order.max", Between(1.0, 40.0), "order at the target; at most min(width, height) − 3"),
    field("epsilon", Between(1e-9, 1.0), "pixel error below which the order is `order.max`"),
    field(
        "noise_floor",
        Words("`ignore`, `subtract`"),
        "whether noise is subtracted from the pixel error in the order rule",
    ),
    field(
        "light",
        Words("`\"none\"`, `{…}`"),
        "estimate how the light has changed since the target: gain, offset and their slopes; not all parts 0",
    ),
    field("light.gain_std", Between(0.0, 10.0), "how far the gain may go from frame to frame; 0.06 unless named"),
    field("light.offset_std", Between(0.0, 10.0), "the same for the offset, gray in [0, 1]; 0.015 unless named"),
    field(
        "light.gain_slope_std",
        Between(0.0, 10.0),
        "the same for the gain's slope along each axis, centre to border; 0.05 unless named",
    ),
    field("light.offset_slope_std", Between(0.0, 10.0), "the same for the offset's slope; 0.015 unless named"),
    field(
        "gain",
        Words("null, `{\"step_fraction\"}`, `{\"per_s\"}`, `{\"adaptive\"}`"),
        "null: `{\"step_fraction\": 0.5}` for requests, `{\"per_s\": 1.0}` for pushed frames",
    ),
    field("gain.step_fraction", Between(1e-3, 1.0), "share of the step taken in one `frame_period_s`"),
    field("gain.per_s", Between(1e-3, 100.0), "λ, 1/s; keep λ · delay ≤ 0.35"),
    field("gain.adaptive.at_zero", Between(1e-3, 100.0), "λ at the target, 1/s"),
    field("gain.adaptive.at_infinity", Between(1e-3, 100.0), "λ far away, 1/s; below `at_zero`"),
    field("gain.adaptive.slope_at_zero", Between(0.0, 1e4), "how fast λ falls with √pixel_mse at the target, 1/s"),
    field("frame_period_s", Between(0.001, 10.0), "time between two frames; a setting, never measured"),
    field("step_cap", Words("`{…}`, `\"none\"`"), "bounds of the full Gauss-Newton step, before the gain"),
    field("step_cap.translation_m", Between(1e-6, 10.0), "norm of its translation"),
    field("step_cap.rotation_rad", Between(1e-6, 3.2), "norm of its rotation"),
    field("camera.fx", Between(1.0, 1e6), "focal length along u, pixels"),
    field("camera.fy", Between(1.0, 1e6), "focal length along v, pixels"),
    field("camera.cx", Between(-1e5, 1e5), "principal point along u, pixels; the first pixel's centre is 0"),
    field("camera.cy", Between(-1e5, 1e5), "principal point along v, pixels"),
    field("camera.width", Between(8.0, 4096.0), "pixels in a row"),
    field("camera.height", Between(8.0, 4096.0), "rows"),
    field(
        "camera.distortion",
        Words("null, or [k1, k2, p1, p2, k3], each −1000 to 1000"),
        "for the record; not applied in this version",
    ),
    field(
        "depth",
        Words("`{\"constant_m\"}`, `\"map\"`, `{\"map\": {\"fallback_m\", \"holes\"}}`, `\"target\"`"),
        "one depth for all; a depth plane in every frame; the target's plane for both images",
    ),
    field(
        "depth.constant_m",
        Between(0.01, 1000.0),
        "depth of every pixel of both images; depth planes are then ignored",
    ),
    field(
        "depth.map.fallback_m",
        Between(0.01, 1000.0),
        "what an unknown depth becomes; null: the frame's median, and `no_depth` over half unknown",
    ),
    field(
        "depth.map.holes",
        Words("`fill`, `ignore`"),
        "a pixel of unknown depth is filled and counts, or has no weight in either image; `fill` unless named",
    ),
    field(
        "depth_scale",
        Words("`given`, `estimate`"),
        "whether a constant depth is right, or its scale is estimated on the way; moments under a fixed window only",
    ),
    field("preprocess.invert", Words("true, false"), "1 − gray, when the object is darker than its surroundings"),
    field("preprocess.resize", Words("null"), "not supported by this version"),
    field("preprocess.mask", Words("null, `{\"png_base64\"}`"), "which pixels count; null: all of them"),
    field(
        "preprocess.mask.png_base64",
        Words("at most 786432 characters"),
        "an 8-bit gray PNG of the camera's size: white counts, black is ignored, gray in between",
    ),
    field("preprocess.undistort", Words("false"), "not supported by this version"),
    field("limits", Words("`{…}`, `\"none\"`"), "speed limits of every twist; accelerations on `command` only"),
    field("limits.linear_m_per_s", Between(1e-6, 10.0), "norm of the velocity"),
    field("limits.angular_rad_per_s", Between(1e-6, 50.0), "norm of the angular velocity"),
    field("limits.linear_m_per_s2", Between(1e-6, 1000.0), "norm of the acceleration"),
    field("limits.angular_rad_per_s2", Between(1e-6, 1000.0), "norm of the angular acceleration"),
    field(
        "degrees_of_freedom",
        Words("six of true, false; one true at least"),
        "which of x, y, z, ωx, ωy, ωz may move",
    ),
    field("stop.step_m", Between(1e-9, 1.0), "arrived: translation of the full step at most this"),
    field("stop.step_rad", Between(1e-9, 1.0), "arrived: rotation of the full step at most this"),
    field("stop.pixel_mse", Words("null, or 0.000000001 to 1"), "arrived: pixel error at most this, as well"),
    field("stop.hold_frames", Between(1.0, 10_000.0), "for so many frames in a row"),
    field("stop.max_iterations", Between(0.0, 1e9), "give up after so many twists; 0 = never"),
    field(
        "frames",
        Words("`\"requests\"`, `\"pushed\"`, `{\"key\": \"…\"}`"),
        "how frames come: requests on `twist`, pushed on the task's `frame`, pushed on a camera's key; fixed on create",
    ),
    field(
        "frame_secret",
        Words("true, false"),
        "pushed frames must carry the task's `frame_secret` (or its secret); those that do not are dropped and counted",
    ),
    field("ros2", Words("null"), "not supported by this version"),
    field(
        "watchdog_ms",
        Words("null, or 20 to 60000"),
        "no frame for so long: zeros; null: 3 frame periods, at least 100; refused under 2 periods",
    ),
    field("max_age_ms", Between(1.0, 60_000.0), "an older frame is stale"),
    field(
        "lease",
        Words("`\"client\"`, `{\"process\": \"…\"}`, `\"none\"`"),
        "whose token's going halts the task: any process of the client, this one, nobody's",
    ),
    field(
        "idle_close_s",
        Between(1.0, 604_800.0),
        "with `lease: none`, a task that nobody uses is closed after so long",
    ),
    field("autostart", Words("true, false"), "start with the first frame after the target is set"),
];
