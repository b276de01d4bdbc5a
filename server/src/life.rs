//! The life of a task: what may move, what ends a servoing, and what it takes to begin again.
//!
//! `created → target set (ready) → start → servoing ⇄ paused → converged | failed → closed`. Nothing moves
//! before `start`, save with `autostart`. A latched status stays until `start` or `resume`; the others clear
//! at the next good frame.

use domvs_proto::messages::{Control, Phase};
use domvs_proto::settings::Stop;
use domvs_proto::status::Status;
use domvs_vision::Step;

/// Frames in a row that must have grown beyond [`diverged`]'s bound before a servoing counts as diverging.
pub const DIVERGING_FRAMES: u32 = 10;

/// The counters and the phase of one task.
#[derive(Clone, Debug)]
pub struct Life {
    phase: Phase,
    /// This worker is giving the task up: it moves no more here, but what another goes on from is the phase.
    handed_over: Option<Status>,
    has_target: bool,
    iterations: u64,
    held_frames: u32,
    growing_frames: u32,
    initial_pixel_mse: Option<f64>,
}

/// What a frame means for the servoing that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Go on; `close` says that the step is already under the stop threshold.
    Moving {
        /// Within the stop threshold, but not yet held long enough.
        close: bool,
    },
    /// The servoing has ended with this status.
    Ended(Status),
}

impl Default for Life {
    fn default() -> Self {
        Life {
            phase: Phase::Idle,
            handed_over: None,
            has_target: false,
            iterations: 0,
            held_frames: 0,
            growing_frames: 0,
            initial_pixel_mse: None,
        }
    }
}

impl Life {
    /// What this task says while no frame decides otherwise.
    pub fn status(&self) -> Status {
        if let Some(status) = self.handed_over {
            return status;
        }
        match self.phase {
            Phase::Latched(status) => status,
            _ if !self.has_target => Status::WaitingTarget,
            Phase::Idle => Status::Ready,
            Phase::Running => Status::WaitingFrame,
        }
    }

    /// Whether a good frame may move the camera.
    pub fn is_running(&self) -> bool {
        self.phase == Phase::Running && self.handed_over.is_none()
    }

    /// Where the task stands, whoever owns it.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Pixel error of the first good step since `start`.
    pub fn initial_pixel_mse(&self) -> Option<f64> {
        self.initial_pixel_mse
    }

    /// Goes on where another worker ended, from its phase and counters. What has to be held in a row begins anew.
    pub fn go_on(&mut self, phase: Phase, iterations: u64, initial_pixel_mse: Option<f64>) {
        (self.phase, self.iterations, self.initial_pixel_mse) = (phase, iterations, initial_pixel_mse);
        (self.held_frames, self.growing_frames) = (0, 0);
    }

    /// Images used since `start`.
    pub fn iterations(&self) -> u64 {
        self.iterations
    }

    /// Frames in a row within the stop threshold.
    pub fn held_frames(&self) -> u32 {
        self.held_frames
    }

    /// The law was made anew: what it said before proves nothing. The phase stays.
    pub fn law_changed(&mut self) {
        self.reset();
    }

    /// Starts a task that is ready, by its first frame.
    pub fn autostart(&mut self) {
        if self.status() == Status::Ready {
            self.phase = Phase::Running;
        }
    }

    /// A target was set: counters start anew. A task that had none becomes ready; a latched one stays latched.
    pub fn target_set(&mut self) {
        self.reset();
        self.has_target = true;
    }

    /// The target cannot be used any more.
    pub fn target_lost(&mut self) {
        self.has_target = false;
    }

    /// Obeys a control word. Returns whether the law must forget its initial image. `close` changes nothing here.
    /// Fails with the present status when the word makes no sense now.
    pub fn control(&mut self, control: Control) -> Result<bool, Status> {
        if let Some(status) = self.handed_over {
            return Err(status);
        }
        match (control, self.phase) {
            (Control::Close, _) => Ok(false),
            (Control::Stop, _) => {
                self.latch(Status::Stopped);
                Ok(false)
            }
            (Control::Start, _) if !self.has_target => Err(Status::WaitingTarget),
            _ if !self.has_target => Err(self.status()),
            (Control::Start, _) => {
                self.reset();
                self.phase = Phase::Running;
                Ok(true)
            }
            (Control::Pause, Phase::Running) => {
                self.latch(Status::Paused);
                Ok(false)
            }
            (Control::Pause, Phase::Latched(Status::Paused)) => Ok(false),
            (Control::Resume, Phase::Running) => Ok(false),
            (Control::Resume, Phase::Latched(_)) => {
                self.phase = Phase::Running;
                (self.held_frames, self.growing_frames) = (0, 0);
                Ok(false)
            }
            (Control::Pause | Control::Resume, _) => Err(self.status()),
        }
    }

    /// Ends whatever runs: with a latched status, or, when this worker gives the task up, for good on this worker alone.
    pub fn latch(&mut self, status: Status) {
        match status {
            Status::OwnerLost | Status::Superseded => self.handed_over = Some(status),
            status => self.phase = Phase::Latched(status),
        }
    }

    /// Counts a good step and judges it.
    pub fn advance(&mut self, step: &Step, stop: &Stop) -> Progress {
        self.iterations += 1;
        let initial = *self.initial_pixel_mse.get_or_insert(step.pixel_mse);
        self.growing_frames = if diverged(step.pixel_mse, initial) { self.growing_frames + 1 } else { 0 };
        let close = is_close(step, stop);
        self.held_frames = if close { self.held_frames + 1 } else { 0 };
        let ended = if close && self.held_frames >= stop.hold_frames {
            Some(Status::Converged)
        } else if self.growing_frames >= DIVERGING_FRAMES {
            Some(Status::Diverging)
        } else if stop.max_iterations > 0 && self.iterations >= u64::from(stop.max_iterations) {
            Some(Status::IterationCap)
        } else {
            None
        };
        match ended {
            Some(status) => {
                self.latch(status);
                Progress::Ended(status)
            }
            None => Progress::Moving { close },
        }
    }

    fn reset(&mut self) {
        *self =
            Life { phase: self.phase, handed_over: self.handed_over, has_target: self.has_target, ..Life::default() };
    }
}

/// The full Gauss-Newton step is under both bounds, and so is the pixel error where the settings ask for it.
fn is_close(step: &Step, stop: &Stop) -> bool {
    let [x, y, z, rx, ry, rz] = step.gauss_newton;
    let (translation, rotation) = ((x * x + y * y + z * z).sqrt(), (rx * rx + ry * ry + rz * rz).sqrt());
    translation <= stop.step_m
        && rotation <= stop.step_rad
        && stop.pixel_mse.is_none_or(|bound| step.pixel_mse <= bound)
}

/// Twice the initial pixel error, and 0.01 more: a large displacement may raise it for a while, not that far.
fn diverged(pixel_mse: f64, initial: f64) -> bool {
    pixel_mse > 2.0 * initial + 0.01
}

#[cfg(test)]
mod tests {
    use domvs_vision::{Twist, WindowInUse};

    use super::*;

    const STOP: Stop = Stop { step_m: 5e-4, step_rad: 5e-4, pixel_mse: None, hold_frames: 5, max_iterations: 0 };

    fn step(translation_m: f64, pixel_mse: f64) -> Step {
        Step {
            twist: Twist::ZERO,
            gauss_newton: [translation_m, 0.0, 0.0, 0.0, 0.0, 0.0],
            step_capped: false,
            gain_per_s: 1.0,
            order: 4,
            features: 15,
            window: WindowInUse::Whole,
            pixel_mse,
            feature_error_squared: 1.0,
            condition_number: 10.0,
            rank: 6,
            rank_deficient: false,
            singular_ratio: 0.1,
            light: None,
            depth_scale: 1.0,
            used_fraction: 1.0,
        }
    }

    fn running() -> Life {
        let mut life = Life::default();
        life.target_set();
        assert_eq!(life.control(Control::Start), Ok(true));
        life
    }

    #[test]
    fn nothing_runs_without_a_target_and_a_start() {
        let mut life = Life::default();
        assert_eq!(life.control(Control::Start), Err(Status::WaitingTarget));
        life.target_set();
        assert_eq!((life.status(), life.is_running()), (Status::Ready, false));
        assert_eq!(life.control(Control::Resume), Err(Status::Ready));
        assert_eq!(life.control(Control::Start), Ok(true));
        assert!(life.is_running());
    }

    #[test]
    fn a_stop_before_the_target_outlives_it() {
        let mut life = Life::default();
        life.latch(Status::Stopped);
        assert_eq!(life.control(Control::Start), Err(Status::WaitingTarget), "what is missing, not what it says");
        life.target_set();
        life.autostart();
        assert_eq!((life.status(), life.is_running()), (Status::Stopped, false));
    }

    #[test]
    fn converged_means_that_the_step_stayed_small() {
        let mut life = running();
        for close in [true, true, true, true, false, true, true, true, true] {
            let step = step(if close { 4e-4 } else { 6e-4 }, 0.01);
            assert_eq!(life.advance(&step, &STOP), Progress::Moving { close });
        }
        assert_eq!(life.advance(&step(5e-4, 0.01), &STOP), Progress::Ended(Status::Converged));
        assert_eq!(life.status(), Status::Converged);
    }

    #[test]
    fn a_servoing_that_gets_worse_ends_as_diverging() {
        let mut life = running();
        assert_eq!(life.advance(&step(0.1, 0.02), &STOP), Progress::Moving { close: false });
        for _ in 1..DIVERGING_FRAMES {
            assert_eq!(life.advance(&step(0.1, 0.051), &STOP), Progress::Moving { close: false });
        }
        assert_eq!(life.advance(&step(0.1, 0.051), &STOP), Progress::Ended(Status::Diverging));
    }

    #[test]
    fn one_better_frame_forgives_the_worse_ones_before() {
        let mut life = running();
        for frame in 0..100 {
            let pixel_mse = if frame % 9 == 0 { 0.02 } else { 0.051 };
            assert_eq!(life.advance(&step(0.1, pixel_mse), &STOP), Progress::Moving { close: false });
        }
    }

    #[test]
    fn a_latched_status_stays_until_start_or_resume() {
        for (word, forgets) in [(Control::Start, true), (Control::Resume, false)] {
            let mut life = running();
            life.latch(Status::ClientLost);
            assert_eq!(life.control(Control::Pause), Err(Status::ClientLost));
            assert_eq!(life.control(word), Ok(forgets));
            assert!(life.is_running());
        }
    }
}
