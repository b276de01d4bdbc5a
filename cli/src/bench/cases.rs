//! What is measured: every combination of the sizes, orders, methods and depths that were asked for.

use std::fmt;

use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use domvs_proto::settings::{Camera, Depth, Light, NoiseFloor, OrderRange, TaskSettings, Window};

use crate::options::{MethodOption, SizeOption, WindowOption, positive};

/// The constant depth of every case that has one, m.
pub const DEPTH_M: f64 = 0.8;

/// Which cases.
#[derive(Args, Clone, Debug)]
pub struct CaseOptions {
    /// Sizes of the images, pixels
    #[arg(long = "size", value_name = "WxH", value_delimiter = ',', default_value = "640x480")]
    pub sizes: Vec<SizeOption>,

    /// Orders of the moments; photometric and gaussian_mixture have none [default: 8,16; under load 8]
    #[arg(long = "order", value_name = "N", value_delimiter = ',')]
    pub orders: Vec<u16>,

    /// What is compared between the images
    #[arg(long = "method", value_name = "METHOD", value_enum, value_delimiter = ',', default_value = "hahn")]
    pub methods: Vec<MethodOption>,

    /// One depth for each pixel, or one for all of them [default: both; under load constant]
    #[arg(long = "depth", value_name = "DEPTH", value_enum, value_delimiter = ',')]
    pub depths: Vec<DepthKind>,

    /// Hahn's window: adaptive, adaptive_paper, a,b or ax,bx,ay,by [default: a task's own, 8,8; where it moves, adaptive]
    #[arg(long, value_name = "W", allow_hyphen_values = true)]
    pub window: Option<WindowOption>,

    /// Standard deviation of the gaussian mixture's blur, pixels [default: an eighth of the width]
    #[arg(long, value_name = "PX", value_parser = positive, allow_hyphen_values = true)]
    pub gaussian_px: Option<f64>,

    /// Estimate how the light has changed
    #[arg(long)]
    pub light: bool,

    /// Subtract the noise of the images
    #[arg(long)]
    pub noise_floor: bool,
}

/// `--depth`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DepthKind {
    /// A depth for every pixel of both images
    Map,
    /// One depth for all pixels
    Constant,
}

impl DepthKind {
    /// The word on the command line and in JSON.
    pub fn word(self) -> &'static str {
        match self {
            DepthKind::Map => "map",
            DepthKind::Constant => "constant",
        }
    }
}

/// One combination.
#[derive(Clone, Debug)]
pub struct Case {
    /// Of both images.
    pub size: SizeOption,
    /// 0 for methods whose features are pixels.
    pub order: u16,
    /// What is compared.
    pub method: MethodOption,
    /// What is known of depth.
    pub depth: DepthKind,
    /// The task that this is; the law of every measurement is made of it, as the service does.
    pub settings: TaskSettings,
    /// The same with a window that can move, where the law has one.
    pub moving: TaskSettings,
}

impl CaseOptions {
    /// The same options with these orders and depths where none are given.
    #[must_use]
    pub fn or(mut self, orders: &[u16], depths: &[DepthKind]) -> CaseOptions {
        if self.orders.is_empty() {
            self.orders = orders.to_vec();
        }
        if self.depths.is_empty() {
            self.depths = depths.to_vec();
        }
        self
    }

    /// Every combination, each checked; without other words orders 8 and 16, and both depths.
    ///
    /// # Errors
    /// Fails, naming the case and its numbers, when the law does not take one.
    pub fn cases(&self) -> anyhow::Result<Vec<Case>> {
        let given = self.clone().or(&[8, 16], &[DepthKind::Map, DepthKind::Constant]);
        let mut cases: Vec<Case> = Vec::new();
        for &size in &self.sizes {
            for &method in &self.methods {
                // Without moments there is no order: one case stands for all.
                let orders = if method.0.is_of_moments() { given.orders.as_slice() } else { &[0] };
                for (&order, &depth) in orders.iter().flat_map(|order| given.depths.iter().map(move |d| (order, d))) {
                    cases.push(self.case(size, method, order, depth)?);
                }
            }
        }
        ensure!(!cases.is_empty(), "nothing to measure: no size, order, method or depth is left");
        Ok(cases)
    }

    fn case(&self, size: SizeOption, method: MethodOption, order: u16, depth: DepthKind) -> anyhow::Result<Case> {
        let name = || format!("{method} at {size}, order {order}");
        let highest = size.width.min(size.height) - 3;
        let is_of_moments = method.0.is_of_moments();
        ensure!(
            !is_of_moments || usize::from(order) <= highest,
            "{}: expected orders up to {highest} (shorter side - 3)",
            name()
        );
        let mut settings = TaskSettings::new(camera(size));
        settings.method = method.0;
        if let Some(window) = self.window {
            settings.window = window.into();
        }
        settings.gaussian_px = self.gaussian_px;
        settings.light = self.light.then(Light::default);
        settings.noise_floor = if self.noise_floor { NoiseFloor::Subtract } else { NoiseFloor::Ignore };
        if is_of_moments {
            settings.order = OrderRange { min: order, max: order };
        } else {
            // Not used by these methods; small enough for every size.
            settings.order = OrderRange { min: 1, max: 1 };
        }
        settings.depth = match depth {
            DepthKind::Map => Depth::Map { fallback_m: None, holes: Default::default() },
            DepthKind::Constant => Depth::ConstantM(DEPTH_M),
        };
        let mut moving = settings.clone();
        if self.window.is_none() {
            moving.window = Window::Adaptive;
        }
        for settings in [&settings, &moving] {
            settings.validate().with_context(name)?;
        }
        Ok(Case { size, order, method, depth, settings, moving })
    }
}

/// A camera that sees about 55° along its longer side.
fn camera(size: SizeOption) -> Camera {
    let (width, height) = (size.width as f64, size.height as f64);
    let focal_px = 0.95 * width.max(height);
    let [width_px, height_px] = [size.width, size.height].map(|side| side as u32);
    Camera {
        fx: focal_px,
        fy: focal_px,
        cx: 0.5 * (width - 1.0),
        cy: 0.5 * (height - 1.0),
        width: width_px,
        height: height_px,
        distortion: None,
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Case { size, order, method, depth, .. } = self;
        match order {
            0 => write!(f, "{method} {size} depth {}", depth.word()),
            _ => write!(f, "{method} {size} order {order} depth {}", depth.word()),
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        cases: CaseOptions,
    }

    fn cases(arguments: &[&str]) -> anyhow::Result<Vec<Case>> {
        Line::try_parse_from([&["bench"], arguments].concat())?.cases.cases()
    }

    #[test]
    fn lists_are_combined_and_methods_without_moments_have_no_orders() {
        let lists = ["--size", "97x71,1920x1080", "--size", "96x72", "--order", "3,24", "--method", "hahn,photometric"];
        let cases = cases(&[&lists[..], &["--depth", "map"]].concat()).expect("all are possible");
        assert_eq!(cases.len(), 3 * (2 + 1));
        assert_eq!(cases[0].to_string(), "hahn 97x71 order 3 depth map");
        assert_eq!(cases[2].to_string(), "photometric 97x71 depth map");
    }

    #[test]
    fn an_order_that_the_size_does_not_allow_is_refused_with_the_numbers() {
        let error = format!("{:#}", cases(&["--size", "16x12", "--order", "10"]).expect_err("too high"));
        assert!(error.contains("16x12") && error.contains("up to 9"), "{error}");
        let error = format!("{:#}", cases(&["--order", "41"]).expect_err("beyond every range"));
        assert!(error.contains("41") && error.contains("40"), "{error}");
        assert!(cases(&["--order", "0"]).is_err());
    }
}
