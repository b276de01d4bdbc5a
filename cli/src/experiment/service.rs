//! Who answers the frames of a run: the service's own code in this process, or the real service over Zenoh.
//!
//! Both take the same bytes and must give the same twists, to the last bit; a test holds them to it.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use domvs_client::{ClientError, OutgoingFrame};
use domvs_proto::messages::{Control, ErrorReply};
use domvs_proto::settings::TaskSettings;
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use domvs_server::ServerConfig;
use domvs_server::decode::DecodeLimits;
use domvs_server::pipeline::on_frame;
use domvs_server::task::{Frame, Route, Task};
use tokio::runtime::Runtime;

use crate::commands::demo::Lab;

/// Times that a busy machine may make a question be asked again. Nothing moves meanwhile.
const ATTEMPTS: usize = 20;

/// One task at a time.
pub trait Service {
    /// Makes a task, sets its target and starts it. Returns the code word of a refused target.
    ///
    /// # Errors
    /// Fails when there is no service, or it refuses the settings.
    fn begin(&mut self, settings: &TaskSettings, target: &OutgoingFrame) -> anyhow::Result<Option<&'static str>>;

    /// The twist for a frame.
    ///
    /// # Errors
    /// Fails when no answer comes.
    fn ask(&mut self, frame: &OutgoingFrame) -> anyhow::Result<TwistMessage>;

    /// Closes the task.
    ///
    /// # Errors
    /// Fails when no answer comes.
    fn end(&mut self) -> anyhow::Result<()>;
}

/// The service's task without a network.
#[derive(Default)]
pub struct InProcess {
    task: Option<Task>,
}

impl InProcess {
    /// The answer to a frame as if it were the first: nothing that came before has a part in it.
    ///
    /// # Errors
    /// Fails when nothing was begun.
    pub fn ask_afresh(&mut self, frame: &OutgoingFrame) -> anyhow::Result<TwistMessage> {
        let task = self.task.as_mut().context("a task that was begun")?;
        task.control(Control::Start).map_err(|error| anyhow::anyhow!("{error}"))?;
        self.ask(frame)
    }
}

impl Service for InProcess {
    fn begin(&mut self, settings: &TaskSettings, target: &OutgoingFrame) -> anyhow::Result<Option<&'static str>> {
        let limits = ServerConfig::default().limits;
        let limits = DecodeLimits { max_pixels: limits.pixels_per_frame as u64, max_bytes: limits.bytes_per_payload };
        let mut task = Task::new(settings.clone(), limits);
        let begun = with_frame(target, |frame| task.set_target(frame)).and_then(|_| task.control(Control::Start));
        if let Err(ErrorReply { code, error }) = begun {
            tracing::info!(%error, "the target was refused");
            return Ok(Some(code.word()));
        }
        self.task = Some(task);
        Ok(None)
    }

    fn ask(&mut self, frame: &OutgoingFrame) -> anyhow::Result<TwistMessage> {
        let task = self.task.as_mut().context("a task that was begun")?;
        Ok(with_frame(frame, |frame| on_frame(task, frame, Duration::ZERO)))
    }

    fn end(&mut self) -> anyhow::Result<()> {
        self.task = None;
        Ok(())
    }
}

/// The frame as the service sees it when it arrives.
fn with_frame<R>(frame: &OutgoingFrame, use_it: impl FnOnce(&Frame<'_>) -> R) -> R {
    let payload = frame.payload().to_bytes();
    let encoding = frame.encoding().to_string();
    let route = Route::Requested;
    use_it(&Frame {
        header: frame.header(),
        encoding: &encoding,
        payload: (&*payload).into(),
        received: Duration::ZERO,
        route,
    })
}

/// A router, the service and a client in this process, which speak over TCP.
pub struct Network {
    runtime: Runtime,
    lab: Option<Lab>,
}

impl Network {
    /// Starts all three.
    ///
    /// # Errors
    /// Fails when there are no threads or no port.
    pub fn start() -> anyhow::Result<Network> {
        let runtime = crate::runtime()?;
        let lab = Some(runtime.block_on(Lab::start())?);
        Ok(Network { runtime, lab })
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        if let Some(lab) = self.lab.take() {
            self.runtime.block_on(lab.stop());
        }
    }
}

/// A task of the real service; many of them share one [`Network`].
pub struct OverZenoh {
    network: Arc<Network>,
    task: Option<domvs_client::Task>,
}

impl OverZenoh {
    /// A place for a task.
    pub fn on(network: Arc<Network>) -> OverZenoh {
        OverZenoh { network, task: None }
    }
}

impl Service for OverZenoh {
    fn begin(&mut self, settings: &TaskSettings, target: &OutgoingFrame) -> anyhow::Result<Option<&'static str>> {
        let lab = self.network.lab.as_ref().context("the network is up until it is dropped")?;
        self.network.runtime.block_on(async {
            let task = lab.client.create_task(settings).await?;
            match task.set_target(target).await {
                Ok(_) => {}
                Err(ClientError::Refused { code, error, .. }) => {
                    tracing::info!(%error, "the target was refused");
                    task.close().await?;
                    return Ok(Some(code.word()));
                }
                Err(error) => return Err(error.into()),
            }
            task.start().await?;
            self.task = Some(task);
            Ok(None)
        })
    }

    fn ask(&mut self, frame: &OutgoingFrame) -> anyhow::Result<TwistMessage> {
        let task = self.task.as_ref().context("a task that was begun")?;
        self.network.runtime.block_on(ask_again(task, frame))
    }

    fn end(&mut self) -> anyhow::Result<()> {
        if let Some(task) = self.task.take() {
            self.network.runtime.block_on(task.close())?;
        }
        Ok(())
    }
}

/// Nothing moves while there is no answer, so asking again is safe; a busy machine may take longer than one request.
async fn ask_again(task: &domvs_client::Task, frame: &OutgoingFrame) -> anyhow::Result<TwistMessage> {
    let mut last = None;
    for _ in 0..ATTEMPTS {
        match task.twist(frame).await {
            Ok(answer) if matches!(answer.status, Status::Overloaded | Status::DeadlineMissed | Status::StaleFrame) => {
                last = Some(anyhow::anyhow!("the service answered {}", answer.status));
            }
            Ok(answer) => return Ok(answer),
            Err(error) => last = Some(error.into()),
        }
    }
    match last {
        Some(error) => Err(error).with_context(|| format!("no twist after {ATTEMPTS} requests")),
        None => bail!("no request was made"),
    }
}
