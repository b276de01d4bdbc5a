//! How to servo: the options that become task settings, alike for `demo`, `task` and `twist`.

use clap::Args;
use domvs_proto::settings::{self, Gain, OrderRange, TaskSettings};

use super::{MethodOption, OrderOption, WindowOption, positive};

/// What is compared: method, order and window.
#[derive(Args, Clone, Debug)]
pub struct FeatureOptions {
    /// The polynomials that make the moments
    #[arg(long, value_enum, default_value_t)]
    pub method: MethodOption,

    /// Order of the moments: one number, or a range to adapt in (both ends included)
    #[arg(long, value_name = "N|MIN..MAX", default_value_t, allow_hyphen_values = true)]
    pub order: OrderOption,

    /// Hahn's window: adaptive (as the authors' program), adaptive_paper (as printed), a,b or ax,bx,ay,by;
    /// the other methods ignore it
    #[arg(long, value_name = "W", default_value_t, allow_hyphen_values = true)]
    pub window: WindowOption,
}

/// What is compared, and how fast the camera moves.
#[derive(Args, Clone, Debug)]
pub struct ServoOptions {
    /// What is compared.
    #[command(flatten)]
    pub features: FeatureOptions,

    /// Which share of the full step to take within one frame period
    /// [default: 0.5 for requests; for pushed frames λ = 1/s instead]
    #[arg(long, value_name = "FRACTION", value_parser = positive, allow_hyphen_values = true)]
    pub gain: Option<f64>,
}

impl ServoOptions {
    /// Writes these choices into `settings`. Ranges are checked when the settings are sent.
    pub fn apply(&self, settings: &mut TaskSettings) {
        settings.method = self.features.method.into();
        let order = |order: usize| u16::try_from(order).unwrap_or(u16::MAX);
        settings.order = OrderRange { min: order(self.features.order.min), max: order(self.features.order.max) };
        settings.window = self.features.window.into();
        settings.gain = self.gain.map(Gain::StepFraction);
    }
}

impl From<MethodOption> for settings::Method {
    fn from(method: MethodOption) -> settings::Method {
        match method {
            MethodOption::Hahn => settings::Method::Hahn,
            MethodOption::Krawtchouk => settings::Method::Krawtchouk,
            MethodOption::Tchebichef => settings::Method::Tchebichef,
            MethodOption::Cosine => settings::Method::Cosine,
        }
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
