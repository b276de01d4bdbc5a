//! The page of `GET /metrics`: Prometheus' text format (0.0.4). What is a state and no count is looked at when it is asked for.

use domvs_proto::WIRE_VERSION;
use domvs_proto::status::Status;
use prometheus::{Counter, Gauge, IntCounterVec, IntGauge, IntGaugeVec, Opts, Registry, TextEncoder};

use super::{Metrics, process};
use crate::desk::lock;
use crate::worker::Shared;

/// What is looked at whenever the page is asked for.
pub(super) struct Gauges {
    build: IntGaugeVec,
    tasks: IntGaugeVec,
    capacity: IntGauge,
    clients: IntGauge,
    keys: IntGauge,
    epoch: IntGauge,
    load: Gauge,
    threads: IntGauge,
    uptime: Gauge,
    held: IntGaugeVec,
    recorder: IntCounterVec,
    recorder_failed: IntGauge,
    resident: IntGauge,
    files: IntGauge,
    cpu: Counter,
    start: Gauge,
}

impl Gauges {
    pub(super) fn new(registry: &Registry) -> prometheus::Result<Gauges> {
        let whole = |name: &str, help: &str| -> prometheus::Result<IntGauge> {
            let gauge = IntGauge::new(name, help)?;
            registry.register(Box::new(gauge.clone()))?;
            Ok(gauge)
        };
        let real = |name: &str, help: &str| -> prometheus::Result<Gauge> {
            let gauge = Gauge::new(name, help)?;
            registry.register(Box::new(gauge.clone()))?;
            Ok(gauge)
        };
        let whole_by = |name: &str, help: &str, labels: &[&str]| -> prometheus::Result<IntGaugeVec> {
            let gauges = IntGaugeVec::new(Opts::new(name, help), labels)?;
            registry.register(Box::new(gauges.clone()))?;
            Ok(gauges)
        };
        let recorder = Opts::new("domvs_recorder_messages_total", "Messages of the recording");
        let recorder = IntCounterVec::new(recorder, &["outcome"])?;
        registry.register(Box::new(recorder.clone()))?;
        let cpu = Counter::new("process_cpu_seconds_total", "Processor time of all threads")?;
        registry.register(Box::new(cpu.clone()))?;
        Ok(Gauges {
            build: whole_by("domvs_build_info", "Always 1", &["version", "wire_version", "worker"])?,
            tasks: whole_by("domvs_tasks", "Tasks, by the word of their status", &["status"])?,
            capacity: whole("domvs_tasks_limit", "Tasks that the worker takes")?,
            clients: whole("domvs_clients", "Clients whose liveliness token is there")?,
            keys: whole(
                "domvs_session_keys",
                "Keys of the Zenoh session that are used up; no task is made beyond 60000",
            )?,
            epoch: whole("domvs_epoch_max", "Highest epoch of the worker's tasks; 0 without a task")?,
            load: real("domvs_load_ratio", "Busy share of the compute threads over the last second")?,
            threads: whole("domvs_compute_threads", "Compute threads")?,
            uptime: real("domvs_uptime_seconds", "Since the worker started")?,
            held: whole_by("domvs_held_bytes", "Payload bytes that wait, by where", &["place"])?,
            recorder,
            recorder_failed: whole("domvs_recorder_failed", "1 once a write has failed and ended the recording")?,
            resident: whole("process_resident_memory_bytes", "Resident memory")?,
            files: whole("process_open_fds", "Open file descriptors")?,
            cpu,
            start: real("process_start_time_seconds", "When the worker started, Unix time")?,
        })
    }

    fn look(&self, shared: &Shared) {
        let wire = WIRE_VERSION.to_string();
        self.build.with_label_values(&[env!("CARGO_PKG_VERSION"), &wire, shared.worker.as_str()]).set(1);
        let mut tasks = [0; Status::ALL.len()];
        let (mut epoch, mut requests) = (0, 0);
        for desk in shared.desks() {
            tasks[usize::from(lock(&desk.board).status().code())] += 1;
            epoch = epoch.max(i64::from(desk.epoch));
            requests += desk.mailbox.request_bytes();
        }
        for (status, count) in Status::ALL.into_iter().zip(tasks) {
            self.tasks.with_label_values(&[status.word()]).set(count);
        }
        let info = shared.info();
        self.epoch.set(epoch);
        self.capacity.set(i64::from(info.capacity));
        self.clients.set(i64::from(info.clients));
        self.keys.set(shared.spent.count() as i64);
        self.load.set(info.load);
        self.threads.set(i64::from(info.threads));
        self.uptime.set(info.uptime_s);
        self.held.with_label_values(&["requests"]).set(requests as i64);
        self.start.set(shared.metrics.started_wall.as_secs_f64());
        self.look_at_process();
        self.look_at_recorder(shared);
    }

    fn look_at_process(&self) {
        self.resident.set(process::resident_bytes().unwrap_or(0) as i64);
        self.files.set(process::open_files().unwrap_or(0) as i64);
        self.cpu.inc_by((process::cpu_s().unwrap_or(0.0) - self.cpu.get()).max(0.0));
    }

    fn look_at_recorder(&self, shared: &Shared) {
        let counts = shared.recorded();
        let waiting = shared.recorder.as_ref().map_or(0, |recorder| recorder.waiting_bytes());
        self.held.with_label_values(&["recorder"]).set(waiting as i64);
        self.recorder_failed.set(i64::from(counts.failed));
        for (outcome, count) in [("written", counts.written.total()), ("dropped", counts.dropped.total())] {
            let counter = self.recorder.with_label_values(&[outcome]);
            counter.inc_by(count.saturating_sub(counter.get()));
        }
    }
}

impl Metrics {
    /// The page as it is now, with the state of this worker.
    pub(super) fn page(&self, shared: &Shared) -> prometheus::Result<String> {
        // One after another: two that look at once would count a difference twice.
        let gauges = lock(&self.gauges);
        gauges.look(shared);
        TextEncoder::new().encode_to_string(&self.registry.gather())
    }
}
