//! The Rust client of Domvs: connect, make a task, set its target, send frames, get camera twists.
//!
//! ```no_run
//! use domvs_client::{Client, ClientOptions, ImageFile, OutgoingFrame, Camera, TaskSettings};
//!
//! # fn next_image() -> Vec<u8> { vec![0; 640 * 480] }
//! # fn move_camera(_twist: [f64; 6]) {}
//! # #[tokio::main]
//! # async fn main() -> anyhow::Result<()> {
//! let camera = Camera { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5, width: 640, height: 480, distortion: None };
//! let client = Client::connect(ClientOptions::named("arm-1")?.at("tcp/192.168.1.5:7447")?).await?;
//! let task = client.create_task(&TaskSettings::new(camera)).await?;
//! task.set_target(&OutgoingFrame::file(ImageFile::Png, std::fs::read("target.png")?)?).await?;
//! task.start().await?;
//! for sequence in 1..1000 {
//!     let frame = OutgoingFrame::mono8(640, 480, next_image())?.numbered(sequence, 0);
//!     // An error here means: no twist for this frame. Brake, and send the next one.
//!     let twist = task.twist(&frame).await.map_or([0.0; 6], |answer| answer.twist);
//!     move_camera(twist);
//! }
//! task.close().await?;
//! # Ok(())
//! # }
//! ```
//!
//! The files in the order of use: [`zenoh_config`] → [`Client`] → workers → [`Task`] → [`OutgoingFrame`] → answer →
//! [`Commands`].
//! All waits have a limit. What runs on Zenoh's receive path only hands over. Nothing is retried that could move a camera twice.
//! Deliberately not here: images (no pixel is looked at), robots, and the control law.

mod answer;
mod cameras;
mod client;
mod config;
mod error;
mod follow;
mod frame;
mod mailbox;
mod matching;
mod options;
mod task;
mod workers;

pub use client::Client;
pub use config::{DEFAULT_ENDPOINT, LEASE_MS, zenoh_config};
pub use domvs_proto::frame::{PixelFormat, Secret};
pub use domvs_proto::keys::{Name, TaskKey};
pub use domvs_proto::settings::{Camera, TaskSettings};
pub use domvs_proto::status::Status;
pub use domvs_proto::twist::TwistMessage;
pub use error::{ClientError, Silence};
pub use follow::{Commands, Statuses};
pub use frame::{DepthPlane, ImageFile, OutgoingFrame, ReceivedFrame};
pub use options::ClientOptions;
pub use task::Task;
pub use workers::ListedTask;
