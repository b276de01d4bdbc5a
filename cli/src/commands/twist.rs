//! `domvs twist`: the law on two image files. No network, no step cap, no speed limit, no stop or texture rule:
//! what the paper's equations say, on `f64` planes.
//! The data's way: arguments → images and depths → [`solve`] → [`Answer`] → text or JSON.

mod answer;
mod inputs;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use domvs_vision::{
    DepthScale, Gain, Gaussian, GaussianForm, Holes, Law, LightPrior, NoiseFloor, OrderRule, Plane, Servo, Step,
};

use self::answer::Answer;
use self::inputs::Inputs;
use crate::exit;
use crate::options::{CameraOption, DepthOption, FeatureOptions, KrawtchoukOption, LatticeOption, positive};
use crate::paint::{Paint, print_line};

/// Compute one twist from two image files
///
/// The law alone, in double precision: no network, no step cap, no speed limit, no stop or texture rule.
/// The twist is the velocity of the camera in its own frame (x right, y down, z forward): three m/s, three rad/s.
/// Images are PNG, JPEG or TIFF. Gray is 0.299 R + 0.587 G + 0.114 B over 255 (over 65535 for 16 bit), unrounded;
/// float TIFF is taken as it is.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct TwistArgs {
    /// The image that the camera should see in the end
    #[arg(long, value_name = "FILE")]
    pub desired: PathBuf,

    /// The image that the camera sees now
    #[arg(long, value_name = "FILE")]
    pub current: PathBuf,

    /// The image that the servoing began with, which the adaptive order compares with [default: the current image]
    #[arg(long, value_name = "FILE")]
    pub initial: Option<PathBuf>,

    /// Focal lengths and principal point in pixels; the centre of the first pixel is 0,0
    #[arg(long, value_name = "FX,FY,CX,CY", allow_hyphen_values = true)]
    pub camera: CameraOption,

    /// Depth seen from the desired pose: metres, a 16-bit PNG, or a 32-bit float TIFF in metres
    /// [default: the current depth if that is given, or else 1 m]
    #[arg(long, value_name = "X", allow_hyphen_values = true)]
    pub desired_depth: Option<DepthOption>,

    /// Depth seen from the current pose, likewise [default: the desired depth if that is given, or else 1 m]
    #[arg(long, value_name = "X", allow_hyphen_values = true)]
    pub current_depth: Option<DepthOption>,

    /// Metres per count of 16-bit depth files
    #[arg(long, value_name = "M", default_value = "0.001", value_parser = positive, allow_hyphen_values = true)]
    pub depth_unit: f64,

    /// What is compared.
    #[command(flatten)]
    pub features: FeatureOptions,

    /// Krawtchouk's centre as fractions of the image: adaptive, or px,py; the other methods ignore it
    #[arg(long, value_name = "P", default_value_t, allow_hyphen_values = true)]
    pub krawtchouk_p: KrawtchoukOption,

    /// Krawtchouk's points; the other methods ignore it
    #[arg(long, value_enum, default_value_t)]
    pub lattice: LatticeOption,

    /// The pixel error at which the adaptive order is at its largest
    #[arg(long, value_name = "E", default_value = "1e-3", value_parser = positive, allow_hyphen_values = true)]
    pub epsilon: f64,

    /// λ in 1/s: the twist is −λ L⁺ e
    #[arg(long, value_name = "G", default_value = "1.0", value_parser = positive, allow_hyphen_values = true)]
    pub gain: f64,

    /// Use 1 − I of every image, for dark objects on a bright ground
    #[arg(long)]
    pub invert: bool,

    /// Print one JSON object instead of a table
    #[arg(long)]
    pub json: bool,
}

const AFTER_HELP: &str = "\
Unknown depths (0, negative or not finite) become the median of the known ones, or with --ignore-holes have no weight; \
more than half unknown is an error. \
A depth map given for one of the two images only is used for both.

The JSON object has the keys twist (6), order, window, pixel_mse, feature_error_squared (e·e), features, \
condition_number and status: servoing, or rank_deficient with a twist of zeros. \
window is ax,bx,ay,by for Hahn, p_x,p_y for Krawtchouk and null for the others; order is 0 for photometric and \
gaussian_mixture, whose sums are made in full here. With --light there is light (6) too: how the current image differs from the desired \
one in gain (-0.3 is 30 % darker), offset, the gain's slopes along x and y, the offset's slopes.

Exit codes: 0 there is an answer, 1 an error, 2 the command line was not understood.";

/// Reads the files, applies the law once and prints the answer.
///
/// # Errors
/// Fails, naming the file or the numbers, when a file cannot be read, sizes differ, a depth map is mostly unknown,
/// the order is too high for the images or an image is unfit for an adaptive window.
pub fn run(args: &TwistArgs, paint: Paint) -> anyhow::Result<ExitCode> {
    let inputs = Inputs::read(args)?;
    let answer = Answer::new(&solve(args, &inputs)?);
    let text = if args.json { serde_json::to_string(&answer)? } else { answer.text(args, &inputs, paint) };
    print_line(&text).context("cannot write the answer")?;
    Ok(exit::done())
}

fn solve(args: &TwistArgs, inputs: &Inputs) -> anyhow::Result<Step> {
    let law = law(args, &inputs.desired.plane)?;
    let mut servo =
        Servo::new(law, inputs.camera, inputs.desired.view()).with_context(|| inputs.desired.name.clone())?;
    if let Some(mask) = &inputs.mask {
        servo.set_mask(Some(&mask.plane)).with_context(|| mask.name.clone())?;
    }
    if let Some(initial) = &inputs.initial {
        servo.set_initial(&initial.plane).with_context(|| initial.name.clone())?;
    }
    servo
        .step(inputs.current.view())
        .with_context(|| format!("{} towards {}", inputs.current.name, inputs.desired.name))
}

fn law(args: &TwistArgs, desired: &Plane<f64>) -> anyhow::Result<Law> {
    let features = &args.features;
    Ok(Law {
        method: features.method.of_the_law(),
        window: features.window.into(),
        krawtchouk_p: args.krawtchouk_p.into(),
        lattice: args.lattice.into(),
        order: OrderRule::new(features.order.min, features.order.max, args.epsilon)?,
        gain: Gain::PerSecond(args.gain),
        step_cap: None,
        degrees_of_freedom: [true; 6],
        gaussian: Gaussian { extent_px: features.gaussian_px(desired), form: GaussianForm::Exact },
        light: features.light.then(LightPrior::default),
        noise_floor: if features.noise_floor { NoiseFloor::Subtracted } else { NoiseFloor::Ignored },
        depth_scale: DepthScale::Given,
        holes: if features.ignore_holes { Holes::Ignored } else { Holes::Filled },
    })
}
