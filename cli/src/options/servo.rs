//! How to servo: the options that become task settings, alike for `demo`, `task` and `twist`.

use std::path::PathBuf;

use clap::Args;
use domvs_proto::settings::{self, DepthScale, Gain, Holes, Light, NoiseFloor, OrderRange, TaskSettings};
use domvs_vision::Plane;

use super::{MethodOption, OrderOption, WindowOption, positive};
use crate::files::{mask_png, read_gray};

/// What is compared: method, order, window, and what of the images counts.
#[derive(Args, Clone, Debug)]
pub struct FeatureOptions {
    /// What is compared between the images
    #[arg(long, value_enum, default_value_t)]
    pub method: MethodOption,

    /// Order of the moments: one number, or a range to adapt in (both ends included)
    #[arg(long, value_name = "N|MIN..MAX", default_value_t, allow_hyphen_values = true)]
    pub order: OrderOption,

    /// Hahn's window: adaptive (as the authors' program), adaptive_paper (as printed), a,b or ax,bx,ay,by;
    /// the other methods ignore it
    #[arg(long, value_name = "W", default_value_t, allow_hyphen_values = true)]
    pub window: WindowOption,

    /// Standard deviation of the gaussian mixture's blur, pixels; the other methods ignore it
    /// [default: an eighth of the width]
    #[arg(long, value_name = "PX", value_parser = positive, allow_hyphen_values = true)]
    pub gaussian_px: Option<f64>,

    /// Estimate how the light has changed since the target: gain, offset and their slopes
    #[arg(long)]
    pub light: bool,

    /// Subtract the noise of the images from the pixel error that the order adapts to
    #[arg(long)]
    pub noise_floor: bool,

    /// An image of the camera's size: white pixels count, black ones are ignored, gray in between
    #[arg(long, value_name = "FILE")]
    pub mask: Option<PathBuf>,

    /// Give pixels of unknown depth no weight, in both images, instead of filling their depth in
    #[arg(long)]
    pub ignore_holes: bool,
}

/// What is compared, and how fast the camera moves.
#[derive(Args, Clone, Debug)]
pub struct ServoOptions {
    /// What is compared.
    #[command(flatten)]
    pub features: FeatureOptions,

    /// Take a constant depth for a guess, and estimate its scale on the way; moments under a fixed window only
    #[arg(long)]
    pub depth_scale: bool,

    /// Which share of the full step to take within one frame period
    /// [default: 0.5 for requests; for pushed frames λ = 1/s instead]
    #[arg(long, value_name = "FRACTION", value_parser = positive, allow_hyphen_values = true)]
    pub gain: Option<f64>,
}

impl FeatureOptions {
    /// The blur of the gaussian mixture for images like this one.
    pub fn gaussian_px(&self, image: &Plane<f64>) -> f64 {
        self.gaussian_px.unwrap_or(image.width() as f64 / 8.0)
    }

    /// What becomes of pixels of unknown depth.
    pub fn holes(&self) -> Holes {
        if self.ignore_holes { Holes::Ignore } else { Holes::Fill }
    }
}

impl ServoOptions {
    /// Writes these choices into `settings`, but for the depth's. Ranges are checked when the settings are sent.
    ///
    /// # Errors
    /// Fails, naming the file, when the mask cannot be read.
    pub fn apply(&self, settings: &mut TaskSettings) -> anyhow::Result<()> {
        let features = &self.features;
        settings.method = features.method.0;
        let order = |order: usize| u16::try_from(order).unwrap_or(u16::MAX);
        settings.order = OrderRange { min: order(features.order.min), max: order(features.order.max) };
        settings.window = features.window.into();
        settings.gaussian_px = features.gaussian_px;
        settings.light = features.light.then(Light::default);
        settings.noise_floor = if features.noise_floor { NoiseFloor::Subtract } else { NoiseFloor::Ignore };
        settings.depth_scale = if self.depth_scale { DepthScale::Estimate } else { DepthScale::Given };
        settings.preprocess.mask =
            features.mask.as_deref().map(|path| mask_png(&read_gray(path)?, path)).transpose()?;
        settings.gain = self.gain.map(Gain::StepFraction);
        Ok(())
    }
}

impl From<WindowOption> for settings::Window {
    fn from(window: WindowOption) -> settings::Window {
        match window {
            WindowOption::Adaptive => settings::Window::Adaptive,
            WindowOption::AdaptivePaper => settings::Window::AdaptivePaper,
            WindowOption::Fixed { x, y } => settings::Window::Fixed { a: [x[0], y[0]], b: [x[1], y[1]] },
        }
    }
}
