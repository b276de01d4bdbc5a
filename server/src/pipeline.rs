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
use crate::law::{gain, speed_limits};
use crate::life::Progress;
use crate::outlet::{Outlet, Received, refused};
use crate::screen::{Gate, Gates, GraySums, Optics};
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
            // A task that stands with it only says so again: a target set since then stays.
            if refusal.status == Status::Internal && task.status() != Status::Internal {
                task.latch(Status::Internal);
            }
            answer.status = refusal.status;
            // They say what was done to a twist, and there is none.
            answer.flags = TwistFlags::default();
            task.detail = refusal.detail;
        }
    }
    answer
}

/// Sends on `command` what [`on_frame`] has answered to a pushed frame: governed, or as zeros if the world went on meanwhile.
/// `halted` is a status that waits to be latched. Returns the message as it was sent.
pub fn send_answer(
    task: &mut Task,
    outlet: &mut Outlet,
    frame: &Frame<'_>,
    answer: TwistMessage,
    halted: Option<Status>,
    now: Moment,
) -> TwistMessage {
    let late = is_past_deadline(frame.header.deadline_us, now.saturating_sub(frame.received));
    let overruled = halted.or(late.then_some(Status::DeadlineMissed)).filter(|_| answer.is_servoing());
    let current = overruled.map_or(answer, |status| refused(answer, status));
    let sent = outlet.send(current, Received { at: frame.received, clock: task.sender_clock(frame) }, now);
    let twist = Twist::from_array(sent.twist);
    task.commanded(twist);
    if answer.is_servoing() {
        task.told(twist);
    }
    sent
}

/// Looks once more before a request is answered: the computation took time, and the world went on. `halted` is a status that waits to
/// be latched.
pub fn recheck(
    answer: TwistMessage,
    outlet: &Outlet,
    frame: &Frame<'_>,
    halted: Option<Status>,
    now: Moment,
) -> TwistMessage {
    if !answer.is_servoing() {
        return answer;
    }
    if let Some(status) = halted {
        return refused(answer, status);
    }
    if is_past_deadline(frame.header.deadline_us, now.saturating_sub(frame.received)) {
        return refused(answer, Status::DeadlineMissed);
    }
    // What came while the process stood still may have waited for as long as it did.
    if outlet.is_awake(frame.received, now) { answer } else { refused(answer, Status::StaleFrame) }
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
    check_texture(&mut task.gates, decoded.sums)?;
    let mut image = &*decoded.image;
    if frame.route == Route::Pushed {
        let watchdog = Duration::from_millis(u64::from(task.settings.watchdog_ms()));
        let focal_px = task.settings.camera.fx.max(task.settings.camera.fy);
        let optics = Optics { focal_px, depth_m: target.typical_depth_m };
        if task.freeze.is_frozen(decoded.image, frame.received, watchdog, optics) {
            return Err(Status::FrozenFrame.into());
        }
        image = task.freeze.newest().unwrap_or(decoded.image);
    }
    let current_filled = update_depth(&mut target.depth, &mut task.gates.known_depth, &task.settings, decoded.depth)?;

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
    check_rank(&mut task.gates.singular_ratio, &step)?;
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
        let (max_age, watchdog) = (task.max_age(), task.watchdog());
        let (judged, oldest) = match frame.header.capture_time_ns {
            0 => (task.age.judge_untimed(frame.header.sequence, frame.received, watchdog), watchdog),
            captured => (task.age.judge(captured, frame.header.sequence, frame.received, max_age), max_age),
        };
        let Age::Fresh(age) = judged else { return Err(Status::StaleFrame.into()) };
        task.age_at_receipt = age;
        if waited > watchdog || age + waited > oldest {
            return Err(Status::StaleFrame.into());
        }
    }
    Ok(())
}

/// Whether an answer after `waited` comes too late for the one who asked; a deadline of 0 is none.
fn is_past_deadline(deadline_us: u32, waited: Duration) -> bool {
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

/// Black, white and flat pictures.
fn check_texture(gates: &mut Gates, sums: GraySums) -> Result<(), Refusal> {
    let (contrast, unclipped) = (sums.contrast(), sums.unclipped());
    // Both are judged, so that each knows on which side of its threshold the last picture was.
    let (has_contrast, has_grays) = (gates.contrast.check(contrast), gates.unclipped.check(unclipped));
    has_contrast.map_err(|asked| {
        let detail = format!("the contrast of the image must be at least {asked}, got {contrast:.4}");
        Refusal::because(Status::LowTexture, detail)
    })?;
    has_grays.map_err(|asked| {
        let detail = format!(
            "the share of pixels that are not black, and of those that are not white, must be at least {asked}, got {unclipped:.4}"
        );
        Refusal::because(Status::LowTexture, detail)
    })
}

/// Whether all free degrees show in the image, by a margin if they did not before.
fn check_rank(gate: &mut Gate, step: &Step) -> Result<(), Refusal> {
    let margin = gate.check(if step.rank_deficient { 0.0 } else { step.singular_ratio });
    margin.map_err(|asked| {
        let detail = format!(
            "the image fixes {} of the free degrees of freedom; the ratio of the singular values must be at least {asked}, got {:.1e}",
            step.rank, step.singular_ratio
        );
        Refusal::because(Status::RankDeficient, detail)
    })
}

/// Brings the current view's depth up to date; says whether any of it was filled in.
fn update_depth(
    depth: &mut Depth<f32>,
    gate: &mut Gate,
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
    if fallback_m.is_none() {
        let known = 1.0 - unknown as f64 / pixels as f64;
        gate.check(known).map_err(|asked| {
            no_depth(format!("the depth of {unknown} of {pixels} pixels is unknown; a share of {asked} must be known"))
        })?;
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
    let Some(limits) = speed_limits(settings) else { return twist };
    let (twist, speed_limited) = limit_speed(twist, limits);
    answer.flags.speed_limited = speed_limited;
    twist
}
