//! The service as a process is stopped and goes on while a camera keeps sending: what waited in the system's buffers is old, whatever the
//! time of its receipt.

use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime};

use domvs_client::{Client, ClientOptions, OutgoingFrame, Task};
use domvs_proto::settings::{Camera, Frames, Gain, Lease, Stop, TaskSettings};
use domvs_proto::twist::TwistMessage;

use crate::network::Place;

const SIDE: u32 = 96;
const PERIOD: Duration = Duration::from_millis(33);
const STANDSTILL: Duration = Duration::from_secs(3);
const LIMIT: Duration = Duration::from_secs(20);
/// `max_age_ms`, and what a busy machine may add between the note of a time and the exposure that it stands for.
const YOUNG: Duration = Duration::from_millis(200 + 50);

/// Three soft spots, shifted: a camera that is always as far away, and never sends the same picture twice.
fn picture(shift_px: f64) -> Vec<u8> {
    let spots = [(30.0, 30.0, 150.0), (65.0, 28.0, 80.0), (50.0, 68.0, 200.0)];
    let gray = |u: f64, v: f64| {
        let spot = |&(x, y, width): &(f64, f64, f64)| (-((u - shift_px - x).powi(2) + (v - y).powi(2)) / width).exp();
        (200.0 * spots.iter().map(spot).sum::<f64>() + 0.3 * u).min(255.0) as u8
    };
    (0..SIDE * SIDE).map(|pixel| gray(f64::from(pixel % SIDE), f64::from(pixel / SIDE))).collect()
}

fn settings() -> TaskSettings {
    let centre = f64::from(SIDE - 1) / 2.0;
    let camera = Camera { fx: 90.0, fy: 90.0, cx: centre, cy: centre, width: SIDE, height: SIDE, distortion: None };
    TaskSettings {
        frames: Frames::Pushed,
        lease: Lease::None,
        gain: Some(Gain::PerS(0.1)),
        stop: Stop { step_m: 1e-9, step_rad: 1e-9, ..Stop::default() },
        ..TaskSettings::new(camera)
    }
}

/// A camera, and what it knows of its own frames.
struct Sending {
    task: Task,
    timed: bool,
    /// When the frame of each sequence was taken.
    taken: Vec<Instant>,
}

impl Sending {
    async fn one(&mut self) {
        let sequence = self.taken.len() as u64;
        let clock = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos() as u64;
        self.taken.push(Instant::now());
        let pixels = picture(2.0 + (sequence % 7) as f64 * 0.2);
        let frame = OutgoingFrame::mono8(SIDE, SIDE, pixels).unwrap();
        self.task.push(&frame.numbered(sequence, if self.timed { clock } else { 0 })).await.unwrap();
    }

    /// Sends at its rate until it is enough.
    async fn until(&mut self, what: &str, enough: impl Fn() -> bool) {
        let (begin, mut rate) = (Instant::now(), tokio::time::interval(PERIOD));
        while !enough() {
            assert!(begin.elapsed() < LIMIT, "not within {LIMIT:?}: {what}");
            rate.tick().await;
            self.one().await;
        }
    }
}

fn signal(place: &Place, name: &str) {
    let sent = Command::new("kill").args([name, &place.process().to_string()]).status().unwrap();
    assert!(sent.success(), "kill {name}");
}

async fn stand_still(timed: bool) {
    let place = Place::start();
    let options = ClientOptions {
        connect_limit: LIMIT,
        discovery_limit: LIMIT,
        request_timeout: LIMIT,
        ..ClientOptions::named("camera").unwrap()
    };
    let client = Client::connect(options.at(&place.endpoint).unwrap()).await.unwrap();
    let task = client.create_task(&settings()).await.unwrap();
    task.set_target(&OutgoingFrame::mono8(SIDE, SIDE, picture(0.0)).unwrap()).await.unwrap();
    task.start().await.unwrap();

    let heard = Arc::new(Mutex::new(Vec::<(Instant, TwistMessage)>::new()));
    let sink = Arc::clone(&heard);
    let command = client.session().declare_subscriber(client.keys().command(task.key()));
    let _commands = command
        .callback(move |sample| {
            let message = TwistMessage::decode(&sample.payload().to_bytes()).unwrap();
            sink.lock().unwrap().push((Instant::now(), message));
        })
        .await
        .unwrap();
    let moves_after = |sequence: usize| {
        heard.lock().unwrap().iter().any(|(_, message)| message.is_servoing() && message.sequence > sequence as u64)
    };

    let mut camera = Sending { task, timed, taken: vec![] };
    camera.until("motion", || moves_after(5)).await;
    let before = camera.taken.len() as u64;
    signal(&place, "-STOP");
    let stopped = Instant::now();
    camera.until("the pause", || stopped.elapsed() >= STANDSTILL).await;
    let (resumed, last) = (Instant::now(), camera.taken.len() - 1);
    signal(&place, "-CONT");
    camera.until("motion again", || moves_after(last + 3)).await;

    let heard = heard.lock().unwrap();
    let afterwards: Vec<&TwistMessage> =
        heard.iter().filter(|(at, _)| *at > resumed).map(|(_, message)| message).collect();
    // What had left already, and was on its way through Zenoh, goes on with the process; zeros are right behind it.
    let (on_their_way, afterwards) = afterwards
        .split_at(afterwards.iter().take_while(|message| message.is_servoing() && message.sequence < before).count());
    assert!(on_their_way.len() <= 1, "{on_their_way:?}");
    let allowed = if timed { YOUNG } else { Duration::ZERO };
    for message in afterwards.iter().filter(|message| message.is_servoing()) {
        let age = resumed.saturating_duration_since(camera.taken[message.sequence as usize]);
        assert!(
            age <= allowed,
            "frame {} was {age:?} old when the service went on, and moved the camera",
            message.sequence
        );
    }
}

#[test]
fn frames_that_waited_in_buffers_while_the_worker_was_stopped_move_nothing() {
    for timed in [true, false] {
        tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap().block_on(stand_still(timed));
    }
}
