//! The service: bytes in, one plain call, bytes out; many tasks, few threads, one clock.
//!
//! The data's way, which is the order of the files: a Zenoh callback puts a frame into a task's `mailbox`, the
//! `pool` picks the task, [`pipeline::on_frame`] takes the frame through `decode`, `screen`, the law and `life`,
//! and the answer goes back to whoever asked, or through the `governor` and the `outlet` to `command`.
//!
//! Around each [`task`] stand three things that are locked one by one: its *desk*, where the pool does its `orders`
//! and `frames`; its *outlet*, the only way to `command`, which the clock can reach while the desk is busy; and its
//! *board*, which holds what `status` says. `worker` ties all to Zenoh, the `registrar` makes and closes tasks, the
//! `clock` watches what does not happen, the `clerk`s answer what needs no computation, the `replica` stands by for the tasks of
//! other workers. What a client is let have is counted in `tenants` and `quotas`, the token it hangs on is watched in `lease`. Start
//! reading at [`pipeline::on_frame`].

use std::time::Duration;

pub mod config;

mod mailbox;

mod pool;

mod age;

pub mod payload;

pub mod decode;

pub mod law;

pub mod screen;

mod life;

pub mod task;

pub mod pipeline;

mod governor;

mod pause;

mod outlet;

pub mod control;

mod board;

mod desk;

mod lease;

mod tenants;

mod quotas;

mod orders;

mod frames;

mod throttle;

mod refusals;

mod metrics;

mod answers;

mod door;

mod endpoints;

mod clock;

mod ownership;

mod registrar;

mod clerk;

mod replica;

pub mod state_file;

mod state_dir;

mod worker;

mod error;

mod service;

pub mod session;

pub mod record;

pub use age::{DRIFT_NS_PER_S, SETTLING};
pub use clock::TOKEN_GRACE;
pub use config::{ConfigError, ServerConfig};
pub use error::ServiceError;
pub use governor::{AccelerationLimits, Governed, Governor, SpeedLimits, limit_speed};
pub use life::DIVERGING_FRAMES;
pub use outlet::{Outlet, Publish, Received, SenderClock, ZERO_PERIOD};
pub use pause::{Clocks, Pause, TICK};
pub use service::Service;

/// A time by the worker's monotonic clock: since the worker started. Always an argument, never read in the
/// steps themselves, so that tests choose it and a recording can feed it back.
pub type Moment = Duration;
