//! The way of a frame, top to bottom: in time? → may it move? → decode → fit? → depth → law → life → speed limit.
//!
//! Nothing here knows Zenoh or reads a clock. Whatever goes wrong on the way is a [`Status`] and exact zeros.

use std::time::Duration;

use domvs_proto::settings::{self, TaskSettings};
use domvs_proto::status::Status;
use domvs_proto::twist::{TwistFlags, TwistMessage};
use domvs_vision::{Depth, DepthMap, HoleFill, Plane, ServoError, Step, Twist, View};

use crate::Moment;
use crate::age::Age;
use crate::decode::{DepthRows, invert};
use crate::governor::limit_speed;
use crate::law::gain;
use crate::life::Progress;
use crate::screen::FLAT_BELOW;
use crate::task::{Estimates, Frame, Route, Task, Told};

/// Why a frame moves nothing: the status, and the numbers behind it.
struct Refusal {
    status: Status,
    detail: Option<String>,
}

impl From<Status> for Refusal {
    fn from(status: Status) -> Refusal {
        Refusal { status, detail: None }
    }
}

impl Refusal {
    fn because(status: Status, detail: impl std::fmt::Display) -> Refusal {
        Refusal { status, detail: Some(detail.to_string()) }
    }
}

/// Answers one frame at `now`. Every status but `servoing` comes with exact zeros.
pub fn on_frame(task: &mut Task, frame: &Frame<'_>, now: Moment) -> TwistMessage {
    task.sequence = frame.header.sequence;
    let mut answer = TwistMessage::zero(Status::Internal);
    let outcome = compute(task, frame, now, &mut answer);
    answer.sequence = frame.header.sequence;
    answer.capture_time_ns = frame.header.capture_time_ns;
    answer.valid_ms = task.settings.watchdog_ms();
    match outcome {
        Ok(twist) => {
            answer.status = Status::Servoing;
            answer.twist = twist.to_array();
            task.told(twist);
            task.detail = None;
        }
        Err(refusal) => {
            if refusal.status == Status::Internal {
                task.latch(Status::Internal);
            }
            answer.status = refusal.status;
            task.detail = refusal.detail;
        }
    }
    answer
}

/// The steps in their order; diagnostics are noted in `answer` on the way.
fn compute(task: &mut Task, frame: &Frame<'_>, now: Moment, answer: &mut TwistMessage) -> Result<Twist, Refusal> {
    // The clocks are looked at whatever the task does, but a task that stands says why it stands.
    let in_time = check_time(task, frame, now);
    if in_time.is_ok() {
        autostart(task);
    }
    check_life(task)?;
    in_time?;

    let decoded = task
        .decoder
        .decode(Some(frame.header), frame.encoding, frame.payload, task.limits)
        .map_err(|error| Refusal::because(Status::BadFrame, error))?;
    if task.settings.preprocess.invert {
        invert(decoded.image);
    }
    let target = task.target.as_mut().ok_or(Status::WaitingTarget)?;
    check_size(decoded.image, &task.settings)?;
    check_texture(decoded.contrast)?;
    let mut image = &*decoded.image;
    if frame.route == Route::Pushed {
        let focal_px = task.settings.camera.fx.max(task.settings.camera.fy);
        if task.freeze.is_frozen(decoded.image, frame.received, focal_px, target.typical_depth_m) {
            return Err(Status::FrozenFrame.into());
        }
        image = task.freeze.newest().unwrap_or(decoded.image);
    }
    let current_filled = update_depth(&mut target.depth, &task.settings, decoded.depth)?;

    // Checked settings cannot make a gain that the law refuses.
    target
        .servo
        .set_gain(gain(&task.settings, frame.route))
        .map_err(|error| Refusal::because(Status::Internal, error))?;
    if let Some(displacement) = displacement(target.told.take(), frame, task.settings.frame_period_s) {
        target.servo.moved(displacement);
    }
    let step = target
        .servo
        .step(View { image, depth: &target.depth })
        .map_err(|error| Refusal::because(status_of(&error), error))?;
    target.told = Some(Told { twist: Twist::ZERO, received: frame.received });
    task.estimates = estimates(&step, &task.settings);
    note(answer, &step, current_filled || target.filled || task.estimates.depth_scale.is_some());
    if step.rank_deficient {
        let detail = format!("the image fixes {} of the free degrees of freedom", step.rank);
        return Err(Refusal::because(Status::RankDeficient, detail));
    }
    if !step.twist.to_array().iter().all(|component| component.is_finite()) {
        return Err(Refusal::because(Status::Internal, "the law made a twist that is not finite"));
    }
    match task.life.advance(&step, &task.settings.stop) {
        Progress::Ended(status) => Err(status.into()),
        Progress::Moving { close } => {
            answer.flags.within_threshold = close;
            Ok(limited(step.twist, &task.settings, answer))
        }
    }
}

/// Requests have a deadline of their own; pushed frames an age.
fn check_time(task: &mut Task, frame: &Frame<'_>, now: Moment) -> Result<(), Refusal> {
    let waited = now.saturating_sub(frame.received);
    if is_past_deadline(frame.header.deadline_us, waited) {
        let detail = format!("the deadline was {} µs, {} µs have passed", frame.header.deadline_us, waited.as_micros());
        return Err(Refusal::because(Status::DeadlineMissed, detail));
    }
    if frame.route == Route::Pushed {
        let max_age = Duration::from_millis(u64::from(task.settings.max_age_ms));
        let judged = task.age.judge(frame.header.capture_time_ns, frame.received, max_age);
        if judged == Age::Stale || waited > task.watchdog() {
            return Err(Status::StaleFrame.into());
        }
    }
    Ok(())
}

/// Whether an answer after `waited` comes too late for the one who asked; a deadline of 0 is none.
pub fn is_past_deadline(deadline_us: u32, waited: Duration) -> bool {
    deadline_us > 0 && waited > Duration::from_micros(u64::from(deadline_us))
}

fn autostart(task: &mut Task) {
    if task.settings.autostart && task.life.status() == Status::Ready {
        task.life.autostart();
    }
}

fn check_life(task: &Task) -> Result<(), Refusal> {
    if task.life.is_running() { Ok(()) } else { Err(task.life.status().into()) }
}

fn check_size(image: &Plane<f32>, settings: &TaskSettings) -> Result<(), Refusal> {
    let (expected, got) = ([settings.camera.width, settings.camera.height], [image.width(), image.height()]);
    if expected.map(|side| side as usize) == got {
        return Ok(());
    }
    let detail =
        format!("expected {}x{} pixels as the target has, got {}x{}", expected[0], expected[1], got[0], got[1]);
    Err(Refusal::because(Status::BadFrame, detail))
}

fn check_texture(contrast: f64) -> Result<(), Refusal> {
    if contrast >= FLAT_BELOW {
        return Ok(());
    }
    let detail = format!("the contrast of the image must be at least {FLAT_BELOW}, got {contrast:.4}");
    Err(Refusal::because(Status::LowTexture, detail))
}

/// Brings the current view's depth up to date; says whether any of it was filled in.
fn update_depth(
    depth: &mut Depth<f32>,
    settings: &TaskSettings,
    plane: Option<DepthRows<'_>>,
) -> Result<bool, Refusal> {
    let settings::Depth::Map { fallback_m, .. } = settings.depth else {
        return Ok(false);
    };
    let no_depth = |detail: String| Refusal::because(Status::NoDepth, detail);
    let Some(plane) = plane else {
        let depth_m =
            fallback_m.ok_or_else(|| no_depth("the frame has no depth plane and there is no fallback_m".into()))?;
        *depth = Depth::Constant { depth_m };
        return Ok(true);
    };
    let fill = fallback_m.map_or(HoleFill::Median, HoleFill::Constant);
    let made = match depth {
        Depth::Map(map) => map.set_rows(fill, plane.rows()),
        Depth::Constant { .. } => {
            DepthMap::from_rows(plane.size(), fill, plane.rows()).map(|map| *depth = Depth::Map(map))
        }
    };
    made.map_err(|error| no_depth(error.to_string()))?;
    let Depth::Map(map) = depth else { return Ok(false) };
    let (unknown, pixels) = (map.unknown(), map.holes().len());
    if fallback_m.is_none() && 2 * unknown > pixels {
        return Err(no_depth(format!("the depth of {unknown} of {pixels} pixels is unknown, more than half")));
    }
    Ok(unknown > 0)
}

/// The word for a step that could not be made. Only holes in the depth change how many pixels have weight.
fn status_of(error: &ServoError) -> Status {
    match error {
        ServoError::Mask(_) => Status::NoDepth,
        _ => Status::BadFrame,
    }
}

/// What the camera was told to do between the last step and this frame: metres and radians. Nothing is known of a camera
/// whose pushed frame did not come about one period later: the twist was meant to last until then, and no longer.
fn displacement(told: Option<Told>, frame: &Frame<'_>, frame_period_s: f64) -> Option<[f64; 6]> {
    let told = told?;
    let periods = frame.received.saturating_sub(told.received).as_secs_f64() / frame_period_s;
    match frame.route {
        Route::Pushed if !(0.5..=1.5).contains(&periods) => None,
        Route::Pushed | Route::Requested => Some(told.twist.to_array().map(|speed| speed * frame_period_s)),
    }
}

fn estimates(step: &Step, settings: &TaskSettings) -> Estimates {
    let estimated = settings.depth_scale == settings::DepthScale::Estimate;
    // The law multiplies the inverse.
    Estimates { light: step.light, depth_scale: estimated.then(|| 1.0 / step.depth_scale) }
}

fn note(answer: &mut TwistMessage, step: &Step, depth_filled: bool) {
    answer.order = u16::try_from(step.order).unwrap_or(u16::MAX);
    answer.features = u16::try_from(step.features).unwrap_or(u16::MAX);
    answer.pixel_mse = step.pixel_mse;
    answer.feature_error_norm = step.feature_error_squared.sqrt();
    answer.condition_number = step.condition_number;
    answer.gain = step.gain_per_s;
    answer.flags = TwistFlags { step_capped: step.step_capped, depth_estimated: depth_filled, ..TwistFlags::default() };
}

fn limited(twist: Twist, settings: &TaskSettings, answer: &mut TwistMessage) -> Twist {
    let Some(limits) = settings.limits else { return twist };
    let (twist, speed_limited) = limit_speed(twist, limits.linear_m_per_s, limits.angular_rad_per_s);
    answer.flags.speed_limited = speed_limited;
    twist
}
