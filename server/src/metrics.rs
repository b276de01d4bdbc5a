//! What a service counts, one worker after another, for `GET /metrics` and for `domvs/worker/<wid>/info`.
//!
//! Every counter is an atomic that was made, with its label, when the service started: to count costs one addition, takes no lock
//! and allocates nothing. Labels are words from fixed lists (statuses, reasons, error codes, keys). Names of tasks and
//! clients are never labels: clients choose them, so there is no end to them. What one task does stands in its `status`.
//!
//! **The counts add up.** Every frame that comes is counted once in `domvs_frames_received_total` and ends once: in
//! `domvs_answers_total`, in one of the reasons of `domvs_frames_dropped_total` that have no answer (`superseded`, `stood_still`,
//! `not_owner`, `quota`, `no_room`, `closed`), or it still waits. The other reasons of `domvs_frames_dropped_total` are answers, too.

mod endpoint;
mod page;
mod process;

use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant, SystemTime};

use domvs_proto::messages::{ErrorCode, FramesDropped, WorkerCounts};
use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use prometheus::{Histogram, HistogramOpts, IntCounter, IntCounterVec, Opts, Registry};

pub(crate) use self::endpoint::MetricsEndpoint;
use self::page::Gauges;
use crate::desk::lock;
use crate::record::RecordCounts;
use crate::task::Route;
use crate::worker::Shared;

/// Resident memory of this process, bytes; 0 where it is not known.
pub(crate) fn resident_bytes() -> u64 {
    process::resident_bytes().unwrap_or(0)
}

/// Upper ends of the buckets of every duration, seconds: from less than a step to longer than any watchdog.
const BUCKETS_S: [f64; 15] =
    [0.000_1, 0.000_25, 0.000_5, 0.001, 0.002, 0.004, 0.008, 0.016, 0.033, 0.066, 0.1, 0.2, 0.5, 1.0, 2.0];

/// Why a frame made no twist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dropped {
    /// A newer pushed frame came before its turn; no answer.
    Superseded,
    /// Answered `bad_frame`.
    Bad,
    /// Answered `stale_frame`.
    Stale,
    /// Answered `overloaded`.
    Overloaded,
    /// Answered `deadline_missed`.
    Deadline,
    /// A pushed frame that waited while the whole worker stood still; no answer.
    StoodStill,
    /// A request without the task's secret: an error instead of an answer. A pushed one without the secret that the settings ask for: no
    /// answer.
    NotOwner,
    /// A pushed frame beyond what its client may send or let wait; no answer.
    Quota,
    /// A request that found no room even for a refusal; no answer.
    NoRoom,
    /// It waited when its task was closed; no answer.
    Closed,
}

impl Dropped {
    const ALL: [(Dropped, &'static str); 10] = [
        (Dropped::Superseded, "superseded"),
        (Dropped::Bad, "bad"),
        (Dropped::Stale, "stale"),
        (Dropped::Overloaded, "overloaded"),
        (Dropped::Deadline, "deadline"),
        (Dropped::StoodStill, "stood_still"),
        (Dropped::NotOwner, "not_owner"),
        (Dropped::Quota, "quota"),
        (Dropped::NoRoom, "no_room"),
        (Dropped::Closed, "closed"),
    ];
}

/// On which key something was asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Asked {
    Create,
    Info,
    Control,
    Settings,
    Target,
    State,
    Twist,
    /// A key of a task that nobody has.
    Unclaimed,
}

impl Asked {
    const ALL: [(Asked, &'static str); 8] = [
        (Asked::Create, "create"),
        (Asked::Info, "info"),
        (Asked::Control, "control"),
        (Asked::Settings, "settings"),
        (Asked::Target, "target"),
        (Asked::State, "state"),
        (Asked::Twist, "twist"),
        (Asked::Unclaimed, "unclaimed"),
    ];
}

const ROUTES: [(Route, &str); 2] = [(Route::Requested, "requested"), (Route::Pushed, "pushed")];

/// Something that happened in the worker, other than to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    TaskCreated,
    /// A task that another worker had lost, or this one in its session before.
    TaskTakenOver,
    /// A task of this worker that a newer owner has: the worker leaves its session.
    TaskSuperseded,
    TaskClosed,
    /// Zeros were sent because no frame had come.
    WatchdogBrake,
    /// A client's token went.
    ClientLost,
    /// A panic ended a task.
    Panic,
    /// The whole worker stood still for longer than a task's watchdog, once for each such task.
    StoodStill,
    /// Neither the registrar nor the clerks had room for a request.
    RequestDropped,
    /// A line that was left out of the log.
    LineLeftOut,
    /// The worker left a session that had used up many keys.
    SessionRenewed,
}

impl Event {
    const ALL: [(Event, &'static str, &'static str); 11] = [
        (Event::TaskCreated, "domvs_tasks_created_total", "Tasks that were created"),
        (Event::TaskTakenOver, "domvs_tasks_taken_over_total", "Tasks that were lost elsewhere and go on here"),
        (
            Event::TaskSuperseded,
            "domvs_tasks_superseded_total",
            "Tasks that another worker took while this one stood still or was cut off; its session was left",
        ),
        (Event::TaskClosed, "domvs_tasks_closed_total", "Tasks that were closed"),
        (Event::WatchdogBrake, "domvs_watchdog_brakes_total", "Zeros sent because no frame came within watchdog_ms"),
        (Event::ClientLost, "domvs_clients_lost_total", "Tasks halted because their client's liveliness token went"),
        (Event::Panic, "domvs_panics_total", "Tasks ended by a defect (status internal)"),
        (
            Event::StoodStill,
            "domvs_stood_still_total",
            "Tasks whose queue was thrown away after the worker stood still",
        ),
        (
            Event::RequestDropped,
            "domvs_requests_dropped_total",
            "Requests that found the worker's queue full, and got no answer",
        ),
        (Event::LineLeftOut, "domvs_log_lines_left_out_total", "Refusals left out of the log: too many in one second"),
        (
            Event::SessionRenewed,
            "domvs_sessions_renewed_total",
            "Sessions left, while no task ran, because many of their keys were used up",
        ),
    ];
}

/// The counters of one service.
pub(crate) struct Metrics {
    /// The worker whose state is shown: the present one.
    shown: Mutex<Weak<Shared>>,
    /// What the recordings of all workers before have counted.
    recorded: Mutex<RecordCounts>,
    started: Instant,
    /// The same as Unix time.
    started_wall: Duration,
    registry: Registry,
    received: [IntCounter; ROUTES.len()],
    received_bytes: IntCounter,
    answers: [[IntCounter; Status::ALL.len()]; ROUTES.len()],
    dropped: [IntCounter; Dropped::ALL.len()],
    asked: [IntCounter; Asked::ALL.len()],
    refused: [IntCounter; ErrorCode::ALL.len()],
    events: [IntCounter; Event::ALL.len()],
    queue: Histogram,
    compute: Histogram,
    total: [Histogram; ROUTES.len()],
    gauges: Mutex<Gauges>,
}

impl Metrics {
    /// Everything at 0. Fails only if two metrics had the same name.
    pub(crate) fn new() -> prometheus::Result<Metrics> {
        let registry = Registry::new();
        let by = |name: &str, help: &str, labels: &[&str]| -> prometheus::Result<IntCounterVec> {
            let family = IntCounterVec::new(Opts::new(name, help), labels)?;
            registry.register(Box::new(family.clone()))?;
            Ok(family)
        };
        let received = by("domvs_frames_received_total", "Frames that came", &["route"])?;
        let answers =
            by("domvs_answers_total", "Answers to frames, by the word of their status", &["route", "status"])?;
        let dropped = by("domvs_frames_dropped_total", "Frames that made no twist", &["reason"])?;
        let asked = by("domvs_requests_total", "Queries that came, by the last part of their key", &["key"])?;
        let refused = by("domvs_refusals_total", "Error answers, by their frozen word", &["code"])?;
        let counter = |name: &str, help: &str| -> prometheus::Result<IntCounter> {
            let counter = IntCounter::new(name, help)?;
            registry.register(Box::new(counter.clone()))?;
            Ok(counter)
        };
        let durations = |name: &str, help: &str, route: Option<&str>| -> prometheus::Result<Histogram> {
            let options = HistogramOpts::new(name, help).buckets(BUCKETS_S.to_vec());
            let options = route.into_iter().fold(options, |options, route| options.const_label("route", route));
            let histogram = Histogram::with_opts(options)?;
            registry.register(Box::new(histogram.clone()))?;
            Ok(histogram)
        };
        let total = |route| durations("domvs_frame_total_seconds", "From a frame's receipt to its answer", Some(route));
        let events = Event::ALL.into_iter().map(|(_, name, help)| counter(name, help));
        let events: Vec<IntCounter> = events.collect::<prometheus::Result<_>>()?;
        Ok(Metrics {
            shown: Mutex::new(Weak::new()),
            recorded: Mutex::default(),
            started: Instant::now(),
            started_wall: SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default(),
            received: ROUTES.map(|(_, route)| received.with_label_values(&[route])),
            received_bytes: counter("domvs_frame_bytes_received_total", "Payload bytes of the frames that came")?,
            answers: ROUTES
                .map(|(_, route)| Status::ALL.map(|status| answers.with_label_values(&[route, status.word()]))),
            dropped: Dropped::ALL.map(|(_, reason)| dropped.with_label_values(&[reason])),
            asked: Asked::ALL.map(|(_, key)| asked.with_label_values(&[key])),
            refused: ErrorCode::ALL.map(|code| refused.with_label_values(&[code.word()])),
            events: std::array::from_fn(|index| events[index].clone()),
            queue: durations("domvs_frame_queue_seconds", "From a frame's receipt to its computation", None)?,
            compute: durations("domvs_frame_compute_seconds", "A frame's computation, decoding included", None)?,
            total: [total(ROUTES[0].1)?, total(ROUTES[1].1)?],
            gauges: Mutex::new(Gauges::new(&registry)?),
            registry,
        })
    }

    /// From now on the page shows the state of this worker.
    pub(crate) fn show(&self, shared: &Arc<Shared>) {
        *lock(&self.shown) = Arc::downgrade(shared);
    }

    /// The worker that is shown; none before the first, and between two sessions.
    fn shown(&self) -> Option<Arc<Shared>> {
        lock(&self.shown).upgrade()
    }

    /// Since the service started.
    pub(crate) fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    /// What all recordings have counted up to the end of a worker, for the next one.
    pub(crate) fn keep_recorded(&self, counts: RecordCounts) {
        *lock(&self.recorded) = counts;
    }

    /// What the recordings of earlier workers have counted.
    pub(crate) fn kept_recorded(&self) -> RecordCounts {
        *lock(&self.recorded)
    }

    /// A frame came.
    pub(crate) fn received(&self, route: Route, bytes: usize) {
        self.received[route as usize].inc();
        self.received_bytes.inc_by(bytes as u64);
    }

    /// A frame was answered; whether its twist is a dropped frame's is told by the status.
    pub(crate) fn answered(&self, route: Route, status: Status) {
        self.answers[route as usize][usize::from(status.code())].inc();
        match status {
            Status::BadFrame => self.dropped(Dropped::Bad),
            Status::StaleFrame => self.dropped(Dropped::Stale),
            Status::Overloaded => self.dropped(Dropped::Overloaded),
            Status::DeadlineMissed => self.dropped(Dropped::Deadline),
            _ => {}
        }
    }

    /// How long a frame took that was computed: until its computation, in it, and until it left.
    pub(crate) fn took(&self, route: Route, answer: &TwistMessage, total: Duration) {
        self.queue.observe(f64::from(answer.queue_us) * 1e-6);
        self.compute.observe(f64::from(answer.compute_us) * 1e-6);
        self.total[route as usize].observe(total.as_secs_f64());
    }

    /// A frame made no twist and has no answer, or is counted as dropped by [`Metrics::answered`].
    pub(crate) fn dropped(&self, reason: Dropped) {
        self.dropped_many(reason, 1);
    }

    /// The same of so many frames.
    pub(crate) fn dropped_many(&self, reason: Dropped, frames: usize) {
        self.dropped[reason as usize].inc_by(frames as u64);
    }

    /// Something was asked.
    pub(crate) fn asked(&self, key: Asked) {
        self.asked[key as usize].inc();
    }

    /// Something was answered with an error.
    pub(crate) fn refused(&self, code: ErrorCode) {
        self.refused[code as usize].inc();
    }

    /// Something happened.
    pub(crate) fn happened(&self, event: Event) {
        self.happened_often(event, 1);
    }

    /// Something happened so many times.
    pub(crate) fn happened_often(&self, event: Event, times: u64) {
        self.events[event as usize].inc_by(times);
    }

    /// How often something has happened.
    pub(crate) fn how_often(&self, event: Event) -> u64 {
        self.events[event as usize].get()
    }

    /// The sums that stand in a worker's `info`.
    pub(crate) fn counts(&self) -> WorkerCounts {
        let sum = |counters: &[IntCounter]| counters.iter().map(IntCounter::get).sum::<u64>();
        let answers: u64 = self.answers.iter().map(|of_route| sum(of_route)).sum();
        let servoing = self.answers.iter().map(|of_route| of_route[usize::from(Status::Servoing.code())].get()).sum();
        let dropped = |reason: Dropped| self.dropped[reason as usize].get();
        WorkerCounts {
            frames_in: sum(&self.received),
            twists: servoing,
            zeros: answers - servoing,
            frames_dropped: FramesDropped {
                superseded: dropped(Dropped::Superseded),
                bad: dropped(Dropped::Bad),
                stale: dropped(Dropped::Stale) + dropped(Dropped::StoodStill),
                overloaded: dropped(Dropped::Overloaded) + dropped(Dropped::Quota) + dropped(Dropped::NoRoom),
                deadline: dropped(Dropped::Deadline),
                not_owner: dropped(Dropped::NotOwner),
            },
            requests: sum(&self.asked),
            refusals: sum(&self.refused),
            watchdog_brakes: self.how_often(Event::WatchdogBrake),
            clients_lost: self.how_often(Event::ClientLost),
            panics: self.how_often(Event::Panic),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_list_stands_in_the_order_of_its_numbers() {
        assert!(ROUTES.iter().enumerate().all(|(at, (route, _))| *route as usize == at));
        assert!(Dropped::ALL.iter().enumerate().all(|(at, (reason, _))| *reason as usize == at));
        assert!(Asked::ALL.iter().enumerate().all(|(at, (key, _))| *key as usize == at));
        assert!(Event::ALL.iter().enumerate().all(|(at, (event, ..))| *event as usize == at));
        assert!(ErrorCode::ALL.iter().enumerate().all(|(at, code)| *code as usize == at));
    }

    #[test]
    fn every_frame_that_came_is_answered_or_dropped() {
        let metrics = Metrics::new().expect("every name is there once");
        for status in [Status::Servoing, Status::BadFrame, Status::Converged] {
            metrics.received(Route::Requested, 10);
            metrics.answered(Route::Requested, status);
        }
        metrics.received(Route::Pushed, 5);
        metrics.dropped(Dropped::Superseded);
        let counts = metrics.counts();
        assert_eq!((counts.frames_in, counts.twists, counts.zeros), (4, 1, 2));
        assert_eq!((counts.frames_dropped.superseded, counts.frames_dropped.bad), (1, 1));
        assert_eq!(counts.frames_in, counts.twists + counts.zeros + counts.frames_dropped.superseded);
    }
}
