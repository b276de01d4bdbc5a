//! What all players share: the router (in this process, so that workers may die), the pictures, the settings; and who only makes trouble:
//! tasks that come and go, and readers that do not read.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use domvs_client::{Client, ClientOptions, OutgoingFrame, zenoh_config};
use domvs_proto::settings::{Camera, Depth, TaskSettings};
use zenoh::bytes::ZBytes;

use super::player::outgoing;
use crate::bench::place::Background;
use crate::bench::scene::Scene;
use crate::bench::watch::Watch;
use crate::options::SizeOption;

/// Pixels of every camera: small, so that many tasks fit on one machine.
pub const SIZE: [u32; 2] = [96, 72];
/// Between two tasks that come and go.
const CHURN: Duration = Duration::from_millis(200);
/// After so many of them their client vanishes and another comes.
const CHURN_CLIENT: u64 = 25;

/// What all players share.
pub struct Stage {
    /// Where the router is.
    pub endpoint: String,
    /// How many workers there are.
    pub workers: usize,
    /// Pixels.
    pub size: [u32; 2],
    /// What the cameras see, in turns.
    pub pictures: [ZBytes; 2],
    /// With the lens cap on.
    pub black: ZBytes,
    /// One byte short.
    pub torn: ZBytes,
    /// Where the cameras should be.
    pub target: OutgoingFrame,
    /// Whether to go on.
    pub watch: Watch,
}

/// Tasks that came and went.
#[derive(Debug, Default)]
pub struct Churned {
    /// Created.
    pub created: AtomicU64,
    /// Closed, and told so.
    pub closed: AtomicU64,
    /// Neither: a worker was away, or a limit was reached.
    pub failed: AtomicU64,
}

impl Stage {
    /// The pictures, for a router at `endpoint`.
    ///
    /// # Errors
    /// Never for this size.
    pub fn new(endpoint: String, workers: usize, watch: Watch) -> anyhow::Result<Stage> {
        let size = SIZE;
        let scene = Scene::new(SizeOption { width: size[0] as usize, height: size[1] as usize });
        let [near, far] = scene.current;
        Ok(Stage {
            endpoint,
            workers,
            size,
            black: vec![0; near.gray.len()].into(),
            torn: near.gray[1..].to_vec().into(),
            pictures: [near.gray.into(), far.gray.into()],
            target: outgoing(size, &scene.desired.gray)?,
            watch,
        })
    }

    /// How to reach the router.
    ///
    /// # Errors
    /// Never for an endpoint that is one.
    pub fn config(&self) -> anyhow::Result<zenoh::Config> {
        Ok(zenoh_config(None, std::slice::from_ref(&self.endpoint))?)
    }

    /// Settings for the cameras here.
    pub fn settings(&self) -> TaskSettings {
        let [width, height] = self.size;
        let center = |side: u32| (f64::from(side) - 1.0) / 2.0;
        let focal_px = f64::from(width);
        let (fx, fy, cx, cy) = (focal_px, focal_px, center(width), center(height));
        let camera = Camera { fx, fy, cx, cy, width, height, distortion: None };
        TaskSettings { depth: Depth::ConstantM(1.0), ..TaskSettings::new(camera) }
    }

    /// A process that subscribes to this key and never reads; it ends when it is dropped.
    pub(super) async fn slow_reader(&self, key: String) -> Option<Background> {
        let words = ["bench", "deaf", "--key", &key, "--endpoint", &self.endpoint].map(str::to_owned);
        let started = tokio::task::spawn_blocking(move || Background::start(&words)).await;
        match started {
            Ok(Ok(process)) => Some(process),
            Ok(Err(error)) => {
                tracing::warn!(%error, "no slow reader");
                None
            }
            Err(_panic) => None,
        }
    }

    /// Makes tasks and closes them, one after another, until `end`; every other one gets a target and is started.
    pub async fn churn(self: Arc<Stage>, end: Instant, churned: Arc<Churned>) {
        let mut generation = 0;
        while Instant::now() < end && !self.watch.is_stopped() {
            generation += 1;
            let Ok(options) = ClientOptions::named(&format!("soak-churn-{generation}")) else { return };
            let Ok(config) = self.config() else { return };
            let Ok(client) = Client::connect(ClientOptions { zenoh: config, ..options }).await else { continue };
            for number in 0..CHURN_CLIENT {
                if Instant::now() >= end {
                    break;
                }
                match self.come_and_go(&client, number, &churned).await {
                    Ok(()) => churned.closed.fetch_add(1, Ordering::Relaxed),
                    Err(error) => {
                        tracing::debug!(%error, "churn");
                        churned.failed.fetch_add(1, Ordering::Relaxed)
                    }
                };
                tokio::time::sleep(CHURN).await;
            }
            let _ = client.close().await;
        }
    }

    async fn come_and_go(
        &self,
        client: &Client,
        number: u64,
        churned: &Churned,
    ) -> Result<(), domvs_client::ClientError> {
        let task = client.create_task(&self.settings()).await?;
        churned.created.fetch_add(1, Ordering::Relaxed);
        if number.is_multiple_of(2) {
            task.set_target(&self.target).await?;
            task.start().await?;
        }
        task.close().await?;
        Ok(())
    }
}
