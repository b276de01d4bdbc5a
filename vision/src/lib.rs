//! Direct visual servoing on discrete orthogonal moments: two images in, one camera twist out.
//!
//! Nothing here reads a file, a clock or a network. The files follow the data:
//! `path → peak → sample → row → image → camera → depth → median → twist → law → weights → noise → pixel error → window → family → order →
//! dense → basis → projection → interaction → along v → table → plan → sweep → moments → gram → light → planes → products → photometric →
//! banded → convolution → low rank → blurred → gaussian → features → control → depth scale → servo`.
//! [`Servo::step`] is the one function that calls the steps from top to bottom; start reading there.
//! `docs/paper.md` maps the paper's equations to these files, its letters to these words, and numbers
//! every place where the code leaves the paper (D1, D2, …) or the paper errs (E1, E2, …).
//!
//! ```
//! use domvs_vision::{Depth, Intrinsics, Law, Plane, Servo, View};
//!
//! let blob = |cu: f64| Plane::from_fn(64, 48, move |u, v| {
//!     (-((u as f64 - cu).powi(2) + (v as f64 - 20.0).powi(2)) / 90.0).exp()
//! });
//! let depth = Depth::Constant { depth_m: 1.0 };
//! let (desired, current) = (blob(30.0), blob(34.0));
//! let camera = Intrinsics::new([60.0, 60.0], [31.5, 23.5])?;
//!
//! let mut servo = Servo::new(Law::default(), camera, View { image: &desired, depth: &depth })?;
//! let step = servo.step(View { image: &current, depth: &depth })?;
//! assert!(!step.rank_deficient && step.twist.is_finite());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

// One group each, so that rustfmt leaves them in the data's order.
mod path;

mod peak;

mod sample;

mod aligned;

mod row;

mod image;

mod camera;

mod depth;

mod median;

mod twist;

mod law;

mod weights;

mod noise;

mod pixel_error;

pub mod window;

pub mod family;

mod order;

mod dense;

pub mod basis;

mod fold;

mod projection;

pub mod interaction;

mod along_v;

mod table;

mod plan;

mod sweep;

mod moments;

pub mod gram;

mod light;

pub mod planes;

mod products;

mod photometric;

mod banded;

pub mod convolution;

mod low_rank;

mod blurred;

mod gaussian;

mod features;

pub mod control;

mod depth_scale;

mod servo;

pub use camera::{CameraError, Intrinsics};
pub use depth::{Depth, DepthError, DepthMap, HoleFill};
pub use family::hahn::Window;
pub use family::krawtchouk::{KrawtchoukP, Lattice};
pub use family::{Method, Polynomial};
pub use image::{ImageError, Plane};
pub use law::{DepthScale, Gain, Gaussian, GaussianForm, Holes, Law, LawError, LightPrior, NoiseFloor, StepCap};
pub use moments::{FeatureRow, Work};
pub use order::{OrderError, OrderRule};
pub use path::Path;
pub use peak::spin;
pub use sample::Sample;
pub use servo::{Servo, ServoError, Step, View};
pub use twist::Twist;
pub use weights::{MaskError, SMALLEST_SHARE};
pub use window::WindowInUse;
