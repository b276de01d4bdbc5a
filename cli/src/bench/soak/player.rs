//! One task of the soak with its camera and its client, by plain Zenoh: frames good and bad go out as bytes, and whatever comes back goes
//! to the judge. A task that is lost is made anew, as any client would.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use domvs_client::{Client, ClientOptions, OutgoingFrame, Status, Task, TwistMessage};
use domvs_proto::frame::{FrameHeader, PixelFormat, RAW};
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::settings::{Frames, TaskSettings};
use domvs_proto::{body, keys::Keys};
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::ConsolidationMode;

use super::judge::{Heard, Judge, Ledger, Sent, lock};
use super::plan::{Event, Fault};
use super::stage::Stage;

/// Frames a second.
const RATE_HZ: f64 = 15.0;
/// How long an answer is waited for; the frame's own deadline is shorter.
const ANSWER: Duration = Duration::from_millis(400);
const DEADLINE: Duration = Duration::from_millis(250);
/// A frame of the past was taken so long ago: far more than `max_age_ms`.
const PAST: Duration = Duration::from_millis(900);
/// Without a sign of life for so long a task is given up: longer than any takeover, if there is a worker that could.
const PATIENCE: [Duration; 2] = [Duration::from_millis(1500), Duration::from_secs(8)];
/// Between two tries for a task.
const AGAIN: Duration = Duration::from_millis(200);
/// Between two starts of a task that has latched.
const RESTART: Duration = Duration::from_millis(300);
/// Numbers of frames: the task's number stands above so many bits.
const NUMBER_BITS: u32 = 40;

/// How frames get to the task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Questions on `twist`.
    Asked,
    /// Published on `frame`, answered on `command`.
    Pushed,
}

/// What everybody may see of a task.
#[derive(Debug, Default)]
pub struct Life {
    /// Its last twist that was not a stop.
    pub moved: Mutex<Option<Instant>>,
    /// A worker's fault that it has not moved since.
    pub struck: Mutex<Option<Instant>>,
    /// It has a task now.
    pub seated: AtomicBool,
}

/// One camera and its client.
pub struct Player {
    pub number: usize,
    pub way: Way,
    pub stage: Arc<Stage>,
    pub judge: Arc<Judge>,
    pub life: Arc<Life>,
    pub events: Vec<Event>,
    pub begin: Instant,
    pub end: Instant,
}

/// A task with all that belongs to it.
struct Seat {
    client: Client,
    task: Task,
    /// Kept for its end.
    _commands: Option<Subscriber<()>>,
    newest: Arc<Mutex<Newest>>,
}

/// What came last.
struct Newest {
    message: Option<TwistMessage>,
    at: Instant,
}

/// Why a seat was left.
enum Left {
    SoakEnds,
    ClientGoes,
    Lost(String),
}

impl Player {
    /// Plays to the end. Returns when the last task is closed.
    pub async fn play(self) {
        let (ledger, mut generation, mut number) = (Arc::new(Ledger::default()), 0, 0);
        while Instant::now() < self.end && !self.stage.watch.is_stopped() {
            generation += 1;
            let seat = match self.take_seat(generation, &ledger).await {
                Ok(seat) => seat,
                Err(error) => {
                    tracing::info!(player = self.number, %error, "no task yet");
                    tokio::time::sleep(AGAIN).await;
                    continue;
                }
            };
            self.life.seated.store(true, Ordering::Relaxed);
            let left = self.sit(&seat, &ledger, &mut number).await;
            self.life.seated.store(false, Ordering::Relaxed);
            match left {
                Left::SoakEnds => {
                    // A worker that ends closes it as well.
                    let _ = seat.task.close().await;
                }
                Left::ClientGoes => {}
                Left::Lost(why) => {
                    let mut findings = self.judge.findings();
                    findings.tasks_lost += 1;
                    findings.last_loss = Some(format!("at {:.1} s: {why}", self.begin.elapsed().as_secs_f64()));
                }
            }
            // Without a word to the task, if it was not the soak's end.
            let _ = seat.client.close().await;
        }
    }

    async fn take_seat(&self, generation: u32, ledger: &Arc<Ledger>) -> anyhow::Result<Seat> {
        let options = ClientOptions::named(&format!("soak-{}-{generation}", self.number))?;
        let client = Client::connect(ClientOptions { zenoh: self.stage.config()?, ..options }).await?;
        let settings = TaskSettings {
            frames: if self.way == Way::Pushed { Frames::Pushed } else { Frames::Requests },
            frame_period_s: 1.0 / RATE_HZ,
            ..self.stage.settings()
        };
        let task = client.create_task(&settings).await?;
        task.set_target(&self.stage.target).await?;
        let newest = Arc::new(Mutex::new(Newest { message: None, at: Instant::now() }));
        let commands = match self.way {
            Way::Asked => None,
            Way::Pushed => Some(self.follow(&client, &task, &settings, ledger, &newest).await?),
        };
        task.start().await?;
        Ok(Seat { client, task, _commands: commands, newest })
    }

    async fn follow(
        &self,
        client: &Client,
        task: &Task,
        settings: &TaskSettings,
        ledger: &Arc<Ledger>,
        newest: &Arc<Mutex<Newest>>,
    ) -> anyhow::Result<Subscriber<()>> {
        let (judge, ledger, newest, life) = (self.judge.clone(), ledger.clone(), newest.clone(), self.life.clone());
        let worth = Duration::from_millis(u64::from(settings.watchdog_ms()));
        let epoch = Mutex::new(0);
        let hear = move |sample: zenoh::sample::Sample| {
            let at = Instant::now();
            let bytes = sample.payload().to_bytes();
            // As every client must: an owner that is no more is not obeyed.
            if let Ok(message) = TwistMessage::decode(&bytes) {
                let mut epoch = lock(&epoch);
                if message.epoch < *epoch {
                    judge.findings().older_epochs += 1;
                    return;
                }
                *epoch = message.epoch;
            }
            let Some(message) = judge.hear(&ledger, &bytes, Heard { asked: None, at, worth }) else { return };
            note_motion(&judge, &life, &message, at);
            *lock(&newest) = Newest { message: Some(message), at };
        };
        let key = client.keys().command(task.key());
        client.session().declare_subscriber(key).callback(hear).await.map_err(|error| anyhow!("command: {error}"))
    }

    /// Sends frames until something ends it.
    async fn sit(&self, seat: &Seat, ledger: &Ledger, number: &mut u64) -> Left {
        let period = Duration::from_secs_f64(1.0 / RATE_HZ);
        let (mut due, mut restarted) = (Instant::now(), Instant::now());
        let patience = PATIENCE[usize::from(self.stage.workers > 1)];
        let mut slow_reader = None;
        loop {
            tokio::time::sleep_until(due.into()).await;
            due = Instant::now().max(due + period);
            if Instant::now() >= self.end || self.stage.watch.is_stopped() {
                return Left::SoakEnds;
            }
            let now = self.begin.elapsed();
            let event = self.events.iter().rev().find(|event| event.is_on(now));
            match event.map(|event| event.fault) {
                Some(Fault::ClientGoes) if event.is_some_and(|event| now - event.at < 2 * period) => {
                    return Left::ClientGoes;
                }
                Some(Fault::SlowReader) if slow_reader.is_none() => {
                    slow_reader = self.stage.slow_reader(seat.client.keys().command(seat.task.key())).await;
                }
                Some(Fault::SlowReader | Fault::CameraStops) => {}
                _ => drop(slow_reader.take()),
            }
            let fault = event.map(|event| event.fault);
            if fault == Some(Fault::CameraStops) {
                if self.way == Way::Asked {
                    // Who asks nothing hears nothing.
                    lock(&seat.newest).at = Instant::now();
                }
            } else {
                *number += 1;
                if let Some(why) = self.send(seat, ledger, *number, fault).await {
                    tracing::debug!(player = self.number, why, "no answer");
                }
            }
            let (message, at) = {
                let newest = lock(&seat.newest);
                (newest.message, newest.at)
            };
            let silence = at.elapsed();
            if silence > patience {
                return Left::Lost(format!("silence for {silence:?} on task {}", seat.task.key()));
            }
            let Some(message) = message else { continue };
            if message.is_servoing() && self.way == Way::Pushed {
                self.judge.still_moves(at, Duration::from_millis(u64::from(message.valid_ms)));
            }
            if message.status.is_latched() && restarted.elapsed() > RESTART {
                restarted = Instant::now();
                if let Err(error) = seat.task.start().await {
                    tracing::info!(player = self.number, status = %message.status, %error, "cannot start again");
                }
            }
        }
    }

    /// Sends one frame, spoiled as the fault says; hears the answer of a question. Returns why there was none.
    async fn send(&self, seat: &Seat, ledger: &Ledger, number: u64, fault: Option<Fault>) -> Option<String> {
        let is_old = fault == Some(Fault::OldFrames) && number.is_multiple_of(3);
        let sequence = (self.number as u64) << NUMBER_BITS | number;
        let taken = self.begin.elapsed().saturating_sub(if is_old { PAST } else { Duration::ZERO });
        let [width, height] = self.stage.size;
        let mut header = FrameHeader {
            sequence,
            capture_time_ns: 1 + u64::try_from(taken.as_nanos()).unwrap_or(u64::MAX - 1),
            ..FrameHeader::new(PixelFormat::Mono8, width, height)
        };
        let payload = match fault {
            Some(Fault::BlackFrames) => self.stage.black.clone(),
            Some(Fault::BadFrames) => self.stage.torn.clone(),
            Some(Fault::FrozenFrames) => self.stage.pictures[0].clone(),
            _ => self.stage.pictures[number as usize % self.stage.pictures.len()].clone(),
        };
        if fault == Some(Fault::LyingHeaders) {
            match number % 3 {
                0 => header.width += 8,
                1 => header.row_bytes = width + 1,
                _ => (header.width, header.height) = (u32::MAX, u32::MAX),
            }
        }
        let spoiled = matches!(fault, Some(Fault::BlackFrames | Fault::BadFrames | Fault::LyingHeaders));
        // A question has no age: it is answered for what it shows.
        let good = !(spoiled || is_old && self.way == Way::Pushed);
        let capture_time_ns = header.capture_time_ns;
        ledger.note(Sent { sequence, capture_time_ns, at: Instant::now(), good });
        self.judge.findings().frames += 1;
        match self.way {
            Way::Pushed => self.push(seat, &header, payload).await.err().map(|error| error.to_string()),
            Way::Asked => self.ask(seat, ledger, header, payload).await,
        }
    }

    async fn push(&self, seat: &Seat, header: &FrameHeader, payload: ZBytes) -> anyhow::Result<()> {
        let key = seat.client.keys().frame(seat.task.key());
        let put = seat.client.session().put(key, payload).encoding(RAW).attachment(header.encode());
        put.congestion_control(CongestionControl::Drop).await.map_err(|error| anyhow!("{error}")).context("frame")
    }

    async fn ask(&self, seat: &Seat, ledger: &Ledger, header: FrameHeader, payload: ZBytes) -> Option<String> {
        let sequence = header.sequence;
        let deadline_us = DEADLINE.as_micros() as u32;
        let header = FrameHeader { secret: seat.task.secret().cloned(), deadline_us, ..header };
        let asked_at = Instant::now();
        let keys: &Keys = seat.client.keys();
        let question = seat.client.session().get(keys.twist(seat.task.key())).payload(payload).encoding(RAW);
        let question = question.attachment(header.encode()).timeout(ANSWER).priority(Priority::RealTime).express(true);
        let replies = match question.consolidation(ConsolidationMode::None).await {
            Ok(replies) => replies,
            Err(error) => return Some(error.to_string()),
        };
        let mut why = Some("no answer".to_owned());
        while let Ok(reply) = replies.recv_async().await {
            match reply.into_result() {
                Ok(sample) => {
                    let at = Instant::now();
                    let heard = Heard { asked: Some(sequence), at, worth: DEADLINE };
                    let Some(message) = self.judge.hear(ledger, &sample.payload().to_bytes(), heard) else { continue };
                    self.judge.findings().answer_ms.add(1e3 * asked_at.elapsed().as_secs_f64());
                    note_motion(&self.judge, &self.life, &message, at);
                    *lock(&seat.newest) = Newest { message: Some(message), at };
                    why = None;
                }
                Err(error) => why = Some(self.refused(&error.payload().to_bytes())),
            }
        }
        if why.is_some() {
            self.judge.findings().unanswered += 1;
        }
        why
    }

    fn refused(&self, bytes: &[u8]) -> String {
        match body::read::<ErrorReply>(bytes) {
            Ok(error) => {
                let mut findings = self.judge.findings();
                *findings.refused.entry(ErrorCode::word(error.code)).or_default() += 1;
                error.to_string()
            }
            Err(_not_ours) => String::from_utf8_lossy(bytes).into_owned(),
        }
    }
}

fn note_motion(judge: &Judge, life: &Life, message: &TwistMessage, at: Instant) {
    if message.status != Status::Servoing {
        return;
    }
    *lock(&life.moved) = Some(at);
    let struck = lock(&life.struck).take_if(|struck| at > *struck);
    if let Some(struck) = struck {
        judge.findings().recovery_ms.add(1e3 * (at - struck).as_secs_f64());
    }
}

/// Eight-bit pictures as a camera sends them.
///
/// # Errors
/// Fails when the pixels are not of this size.
pub fn outgoing([width, height]: [u32; 2], gray: &[u8]) -> anyhow::Result<OutgoingFrame> {
    Ok(OutgoingFrame::mono8(width, height, gray.to_vec())?)
}
