//! One client's servoing towards one target, without a network: what a frame meets on its way and what stays
//! from frame to frame. `pipeline` moves a frame through it; here are its orders: control, target, settings.

use std::time::Duration;

use domvs_proto::frame::FrameHeader;
use domvs_proto::messages::{Control, ErrorCode, ErrorReply, FramesDropped, Progress};
use domvs_proto::settings::{self, TaskSettings};
use domvs_proto::status::Status;
use domvs_vision::{Depth, DepthMap, HoleFill, Servo, Twist, View};
use serde_json::Value;
use sha3::{Digest, Sha3_256};

use crate::Moment;
use crate::age::AgeEstimator;
use crate::decode::{DecodeLimits, Decoder, DepthRows, invert, weights};
use crate::law::{intrinsics, law};
use crate::life::Life;
use crate::outlet::SenderClock;
use crate::payload::Payload;
use crate::screen::{CONTRAST, FreezeDetector, Gates, GraySums, UNCLIPPED};

/// How a frame came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Route {
    /// With a request on `twist`: the answer is pure, no clock but the request's own deadline.
    Requested,
    /// Published by a camera: age, silence and frozen pictures matter.
    Pushed,
}

/// A frame as it arrived.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// What the pixels are.
    pub header: &'a FrameHeader,
    /// The Encoding of the payload, which names PNG and JPEG.
    pub encoding: &'a str,
    /// The bytes.
    pub payload: Payload<'a>,
    /// When it arrived, by this worker's monotonic clock.
    pub received: Moment,
    /// How it came.
    pub route: Route,
}

/// The state of one task.
pub struct Task {
    pub(crate) settings: TaskSettings,
    pub(crate) life: Life,
    pub(crate) decoder: Decoder,
    pub(crate) limits: DecodeLimits,
    pub(crate) target: Option<Target>,
    pub(crate) age: AgeEstimator,
    /// How old the newest fresh frame was when it was received.
    pub(crate) age_at_receipt: Duration,
    pub(crate) freeze: FreezeDetector,
    pub(crate) gates: Gates,
    /// The numbers behind the last refusal.
    pub(crate) detail: Option<String>,
    pub(crate) sequence: u64,
    pub(crate) estimates: Estimates,
}

/// What the law has found out about the world besides the twist, as `status` says it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimates {
    /// How the light differs from the target's: gain, offset, the gain's slopes, the offset's slopes.
    pub light: Option<[f64; 6]>,
    /// What the constant depth is multiplied by.
    pub depth_scale: Option<f64>,
}

/// What was set, and the law made for it.
pub(crate) struct Target {
    pub(crate) servo: Servo<f32>,
    /// Of the current frame; refilled in place when frames bring a map.
    pub(crate) depth: Depth<f32>,
    /// The desired view's depth, where the settings use it for both.
    pub(crate) filled: bool,
    /// A depth typical of the scene, metres: turns a speed into pixels.
    pub(crate) typical_depth_m: f64,
    /// What the camera was told after the last step.
    pub(crate) told: Option<Told>,
    sent: SentTarget,
}

/// A twist that went out, and when the frame it answers came.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Told {
    pub(crate) twist: Twist,
    pub(crate) received: Moment,
}

/// A target as its client sent it, without the secret.
#[derive(Clone, Debug)]
pub struct SentTarget {
    /// The header, without the secret.
    pub header: FrameHeader,
    /// The Encoding.
    pub encoding: String,
    /// The bytes.
    pub payload: Vec<u8>,
    /// The size of its image, pixels; 0 before it has been decoded.
    pub size: [usize; 2],
    hash: String,
}

impl SentTarget {
    /// A target that has not been decoded yet. Only what describes the picture is kept of the header.
    pub fn new(header: FrameHeader, encoding: String, payload: Vec<u8>) -> SentTarget {
        let header = FrameHeader { secret: None, deadline_us: 0, ..header };
        let mut hasher = Sha3_256::new();
        hasher.update(header.encode());
        hasher.update((encoding.len() as u64).to_le_bytes());
        hasher.update(&encoding);
        hasher.update(&payload);
        SentTarget { header, encoding, payload, size: [0, 0], hash: format!("{:x}", hasher.finalize()) }
    }

    /// SHA3-256 of the header as it is kept, the length of the Encoding (u64, little-endian), the Encoding and the payload, in hexadecimal: the
    /// same on every build of a worker, as replicas and files of the state directory compare it.
    pub fn hash(&self) -> &str {
        &self.hash
    }
}

/// The Encoding is kept with the target; bytes.
const LONGEST_ENCODING: usize = 256;

impl Task {
    /// A task without a target. The settings were checked by whoever made them.
    pub fn new(settings: TaskSettings, limits: DecodeLimits) -> Task {
        Task {
            settings,
            life: Life::default(),
            decoder: Decoder::new(),
            limits,
            target: None,
            age: AgeEstimator::default(),
            age_at_receipt: Duration::ZERO,
            freeze: FreezeDetector::default(),
            gates: Gates::default(),
            detail: None,
            sequence: 0,
            estimates: Estimates::default(),
        }
    }

    /// The settings in force.
    pub fn settings(&self) -> &TaskSettings {
        &self.settings
    }

    /// What the task says while no frame decides otherwise.
    pub fn status(&self) -> Status {
        self.life.status()
    }

    /// Whether a good frame may move the camera.
    pub fn is_running(&self) -> bool {
        self.life.is_running()
    }

    /// The numbers behind the last refusal of a frame.
    pub fn detail(&self) -> Option<&str> {
        self.detail.as_deref()
    }

    /// The target as it was sent.
    pub fn target(&self) -> Option<&SentTarget> {
        self.target.as_ref().map(|target| &target.sent)
    }

    /// How far the task is, after it said `status`; frames are counted elsewhere.
    pub fn progress(&self, status: Status) -> Progress {
        Progress {
            status,
            phase: self.life.phase(),
            twists: self.life.iterations(),
            held_frames: self.life.held_frames(),
            sequence: self.sequence,
            initial_pixel_mse: self.life.initial_pixel_mse(),
            initial_order_mse: self.target.as_ref().and_then(|target| target.servo.initial_mse()),
            frames_in: 0,
            frames_dropped: FramesDropped::default(),
        }
    }

    /// Goes on where another owner ended: latched stays latched, what ran may run, with the initial error it had.
    pub(crate) fn go_on(&mut self, progress: &Progress) {
        self.life.go_on(progress.phase, progress.twists, progress.initial_pixel_mse);
        self.sequence = progress.sequence;
        if let Some(target) = self.target.as_mut() {
            target.servo.set_initial_mse(progress.initial_order_mse);
        }
    }

    /// What the clock of its sender says of the frame looked at last; `None` if it came without a capture time.
    pub(crate) fn sender_clock(&self, frame: &Frame<'_>) -> Option<SenderClock> {
        let known_since = self.age.known_since().filter(|_| frame.header.capture_time_ns != 0)?;
        Some(SenderClock {
            known_since,
            fresh_until: frame.received + self.max_age().saturating_sub(self.age_at_receipt),
        })
    }

    /// How old a pushed frame may be.
    pub(crate) fn max_age(&self) -> Duration {
        Duration::from_millis(u64::from(self.settings.max_age_ms))
    }

    /// Good steps since `start`.
    pub fn iterations(&self) -> u64 {
        self.life.iterations()
    }

    /// What the law has found out so far.
    pub fn estimates(&self) -> Estimates {
        self.estimates
    }

    /// Notes the twist that really went out for the frame answered last, which was good; until then its answer stands.
    pub fn told(&mut self, twist: Twist) {
        if let Some(told) = self.target.as_mut().and_then(|target| target.told.as_mut()) {
            told.twist = twist;
        }
    }

    /// Notes the twist that really went out on `command` after a pushed frame.
    pub fn commanded(&mut self, twist: Twist) {
        self.freeze.commanded(twist);
    }

    /// Obeys a control word and says what the status is then.
    pub fn control(&mut self, control: Control) -> Result<Status, ErrorReply> {
        match self.life.control(control) {
            Ok(forget_initial) => {
                if control == Control::Start {
                    self.age.forget_sequence();
                }
                if let Some(target) = self.target.as_mut() {
                    // Nobody knows how the camera was moved while the task stood.
                    target.told = None;
                    if forget_initial {
                        target.servo.restart();
                    }
                }
                // What stood still before this word proves nothing about the camera after it.
                self.freeze = FreezeDetector::default();
                self.gates = Gates::default();
                self.detail = None;
                Ok(self.life.status())
            }
            Err(Status::WaitingTarget) if control == Control::Start => {
                Err(ErrorReply::new(ErrorCode::NoTarget, "set a target before the task can start"))
            }
            Err(status) => Ok(status),
        }
    }

    /// Halts with a latched status, from outside the image's way: stop for all, a lost client, a panic.
    /// After `internal` nothing that a panic may have left half done is used again: the target must be set anew.
    pub fn latch(&mut self, status: Status) {
        self.life.latch(status);
        if status == Status::Internal {
            self.life.target_lost();
            self.target = None;
            self.decoder = Decoder::new();
        }
    }

    /// Takes a desired image. The task keeps its phase; counters and I° start anew. On an error nothing changes.
    pub fn set_target(&mut self, frame: &Frame<'_>) -> Result<Status, ErrorReply> {
        if frame.encoding.len() > LONGEST_ENCODING {
            let error = format!("an Encoding may have {LONGEST_ENCODING} bytes, got {}", frame.encoding.len());
            return Err(ErrorReply::new(ErrorCode::BadTarget, error));
        }
        let payload = frame.payload.to_bytes().into_owned();
        self.take_target(SentTarget::new(frame.header.clone(), frame.encoding.to_owned(), payload))
    }

    /// Takes a desired image as another worker has kept it.
    pub(crate) fn take_target(&mut self, sent: SentTarget) -> Result<Status, ErrorReply> {
        self.target = Some(self.make_target(sent, &self.settings.clone())?);
        self.estimates = Estimates::default();
        self.life.target_set();
        self.freeze = FreezeDetector::default();
        self.gates = Gates::default();
        self.detail = None;
        Ok(self.life.status())
    }

    /// Changes settings by a merge patch and returns those in force then. On an error nothing changes.
    /// A law that changes starts anew on the same target, with a new I°; gain, limits and the like change on the way.
    pub fn change_settings(&mut self, patch: &Value) -> Result<&TaskSettings, ErrorReply> {
        let settings = self.settings.merge_patch(patch).map_err(|error| ErrorReply::from(&error))?;
        if settings.frames != self.settings.frames {
            let error = "frames are fixed when a task is created; create another task";
            return Err(ErrorReply::new(ErrorCode::NotSupported, error));
        }
        if let Some(target) = self.target.as_ref().filter(|_| needs_new_law(&self.settings, &settings)) {
            self.target = Some(self.make_target(target.sent.clone(), &settings)?);
            self.estimates = Estimates::default();
            self.gates = Gates::default();
            self.life.law_changed();
        }
        self.settings = settings;
        Ok(&self.settings)
    }

    /// Decodes a target and makes the law for it.
    fn make_target(&mut self, mut sent: SentTarget, settings: &TaskSettings) -> Result<Target, ErrorReply> {
        let bad = |error: &dyn std::fmt::Display| ErrorReply::new(ErrorCode::BadTarget, error);
        let decoded = self
            .decoder
            .decode(Some(&sent.header), &sent.encoding, (&sent.payload).into(), self.limits)
            .map_err(|error| bad(&error))?;
        let mut image = decoded.image.clone();
        sent.size = [image.width(), image.height()];
        let camera = settings.camera;
        if sent.size != [camera.width as usize, camera.height as usize] {
            let [width, height] = sent.size;
            let error = format!(
                "the camera of the settings has {}x{} pixels, the target {width}x{height}; another camera needs another task",
                camera.width, camera.height
            );
            return Err(bad(&error));
        }
        if settings.preprocess.invert {
            invert(&mut image);
        }
        check_fit(decoded.sums).map_err(|error| bad(&error))?;
        let (depth, filled) = target_depth(settings.depth, decoded.depth).map_err(|error| bad(&error))?;
        let law = law(settings).map_err(|error| bad(&error))?;
        let intrinsics = intrinsics(&camera).map_err(|error| bad(&error))?;
        let view = View { image: &image, depth: &depth };
        let mut servo = Servo::new(law, intrinsics, view).map_err(|error| bad(&error))?;
        if let Some(mask) = &settings.preprocess.mask {
            let weights = weights(mask, self.limits).map_err(|error| bad(&format!("preprocess.mask: {error}")))?;
            servo.set_mask(Some(&weights)).map_err(|error| bad(&format!("preprocess.mask: {error}")))?;
        }
        Ok(Target { servo, typical_depth_m: typical_depth_m(&depth), depth, filled, told: None, sent })
    }

    /// What a pushed frame's silence is judged by.
    pub fn watchdog(&self) -> Duration {
        Duration::from_millis(u64::from(self.settings.watchdog_ms()))
    }
}

/// A target is judged by the same numbers as a frame, without their other side: nothing was refused before.
fn check_fit(sums: GraySums) -> Result<(), String> {
    let (contrast, unclipped) = (sums.contrast(), sums.unclipped());
    let (least, least_unclipped) = (CONTRAST.refuse_below, UNCLIPPED.refuse_below);
    if contrast < least || contrast.is_nan() {
        return Err(format!("the target is flat: its contrast must be at least {least}, got {contrast:.4}"));
    }
    if unclipped < least_unclipped {
        return Err(format!(
            "the target is black or white: the share of other pixels must be at least {least_unclipped}, got {unclipped:.4}"
        ));
    }
    Ok(())
}

/// Whether the law made for the one cannot serve the other. The gain is set with each frame.
fn needs_new_law(now: &TaskSettings, then: &TaskSettings) -> bool {
    let of_the_law = |settings: &TaskSettings| TaskSettings {
        gain: None,
        frame_period_s: now.frame_period_s,
        limits: now.limits,
        stop: now.stop,
        watchdog_ms: now.watchdog_ms,
        max_age_ms: now.max_age_ms,
        idle_close_s: now.idle_close_s,
        autostart: now.autostart,
        lease: now.lease.clone(),
        frame_secret: now.frame_secret,
        ..settings.clone()
    };
    of_the_law(now) != of_the_law(then)
}

/// The desired view's depth, and whether holes in it were filled.
fn target_depth(source: settings::Depth, plane: Option<DepthRows<'_>>) -> Result<(Depth<f32>, bool), String> {
    let fallback_m = match source {
        settings::Depth::ConstantM(depth_m) => return Ok((Depth::Constant { depth_m }, false)),
        settings::Depth::Map { fallback_m, .. } => fallback_m,
        settings::Depth::Target => None,
    };
    let Some(plane) = plane else {
        return match fallback_m {
            Some(depth_m) => Ok((Depth::Constant { depth_m }, true)),
            None => Err("the settings take depth from the target, and it has no depth plane".to_owned()),
        };
    };
    let fill = fallback_m.map_or(HoleFill::Median, HoleFill::Constant);
    let map = DepthMap::from_rows(plane.size(), fill, plane.rows()).map_err(|error| error.to_string())?;
    let (unknown, pixels) = (map.unknown(), map.holes().len());
    if fallback_m.is_none() && 2 * unknown > pixels {
        return Err(format!("the depth of {unknown} of {pixels} pixels of the target is unknown, more than half"));
    }
    Ok((Depth::Map(map), unknown > 0))
}

fn typical_depth_m(depth: &Depth<f32>) -> f64 {
    match depth {
        Depth::Constant { depth_m } => *depth_m,
        Depth::Map(map) => {
            let inverse = map.inverse_per_m().samples();
            let sum: f64 = inverse.iter().map(|&zeta| f64::from(zeta)).sum();
            inverse.len() as f64 / sum
        }
    }
}

#[cfg(test)]
mod tests {
    use domvs_proto::frame::PixelFormat;
    use domvs_proto::settings::Camera;
    use serde_json::json;

    use super::*;
    use crate::pipeline::on_frame;

    const SIDE: u32 = 32;

    /// A smooth blob around `(centre, centre)`, 8-bit.
    fn blob(centre: f64) -> Vec<u8> {
        let gray = |u: u32, v: u32| {
            let (x, y) = (f64::from(u) - centre, f64::from(v) - centre);
            (200.0 * (-(x * x + y * y) / 60.0).exp() + f64::from(u + 2 * v)) as u8
        };
        (0..SIDE * SIDE).map(|pixel| gray(pixel % SIDE, pixel / SIDE)).collect()
    }

    fn header() -> FrameHeader {
        FrameHeader::new(PixelFormat::Mono8, SIDE, SIDE)
    }

    fn frame<'a>(header: &'a FrameHeader, payload: &'a [u8]) -> Frame<'a> {
        Frame { header, encoding: "", payload: payload.into(), received: Duration::ZERO, route: Route::Requested }
    }

    /// A task that has answered two frames.
    fn servoing() -> Task {
        let camera = Camera { fx: 30.0, fy: 30.0, cx: 15.5, cy: 15.5, width: SIDE, height: SIDE, distortion: None };
        let mut task = Task::new(TaskSettings::new(camera), DecodeLimits { max_pixels: 1 << 20, max_bytes: 1 << 20 });
        task.set_target(&frame(&header(), &blob(15.0))).expect("a target");
        task.control(Control::Start).expect("a start");
        for _ in 0..2 {
            assert!(on_frame(&mut task, &frame(&header(), &blob(16.0)), Duration::ZERO).is_servoing());
        }
        task
    }

    #[test]
    fn gain_and_limits_change_on_the_way_and_the_law_begins_anew() {
        let mut task = servoing();
        task.change_settings(&json!({ "gain": { "per_s": 0.5 }, "limits": { "linear_m_per_s": 0.1 } })).expect("valid");
        assert_eq!(task.iterations(), 2);
        let answer = on_frame(&mut task, &frame(&header(), &blob(16.0)), Duration::ZERO);
        assert_eq!(answer.gain, 0.5);
        task.change_settings(&json!({ "order": 6 })).expect("valid");
        assert_eq!(task.iterations(), 0);
        assert!(task.is_running());
    }

    #[test]
    fn a_change_that_cannot_work_changes_nothing() {
        let mut task = servoing();
        let before = task.settings().clone();
        let error = task.change_settings(&json!({ "camera": { "width": 64 } })).expect_err("the target has 32 columns");
        assert!(error.error.contains("64x32") && error.error.contains("32x32"), "{error}");
        assert_eq!((task.settings(), task.iterations()), (&before, 2));
    }

    /// What the depth scale is after three frames, of which the last two came so long after the one before, in periods.
    fn depth_scale_after(route: Route, periods: f64) -> f64 {
        let mut task = servoing();
        task.change_settings(&json!({ "depth_scale": "estimate", "order": 8 })).expect("a constant depth");
        let period = Duration::from_secs_f64(periods * task.settings().frame_period_s);
        for (number, centre) in [17.0, 16.0, 15.5].into_iter().enumerate() {
            let (header, payload, received) = (header(), blob(centre), period * number as u32);
            let frame = Frame { received, route, ..frame(&header, &payload) };
            assert!(on_frame(&mut task, &frame, received).is_servoing());
        }
        task.estimates().depth_scale.expect("it is estimated")
    }

    #[test]
    fn depth_is_learnt_from_frames_that_came_about_one_period_after_the_twist() {
        assert_ne!(depth_scale_after(Route::Pushed, 1.0), 1.0);
        assert_eq!(
            depth_scale_after(Route::Pushed, 1.2),
            depth_scale_after(Route::Pushed, 1.0),
            "the period is a setting"
        );
        for apart in [0.3, 1.7] {
            assert_eq!(depth_scale_after(Route::Pushed, apart), 1.0, "{apart} periods");
        }
        assert_ne!(depth_scale_after(Route::Requested, 1.7), 1.0, "a request is answered in lock step");
    }

    #[test]
    fn a_twist_that_did_not_go_out_moved_nothing() {
        let mut task = servoing();
        task.change_settings(&json!({ "depth_scale": "estimate", "order": 8 })).expect("a constant depth");
        for centre in [17.0, 17.0] {
            assert!(on_frame(&mut task, &frame(&header(), &blob(centre)), Duration::ZERO).is_servoing());
            task.told(Twist::ZERO);
        }
        // No motion and no change say nothing about depth.
        assert_eq!(task.estimates().depth_scale, Some(1.0));
    }

    #[test]
    fn after_a_panic_nothing_moves_before_a_new_target() {
        let mut task = servoing();
        task.latch(Status::Internal);
        assert_eq!(task.control(Control::Start).map_err(|error| error.code), Err(ErrorCode::NoTarget));
        task.set_target(&frame(&header(), &blob(15.0))).expect("a target");
        assert_eq!(task.status(), Status::Internal);
        task.control(Control::Start).expect("a start");
        assert!(task.is_running());
    }
}
