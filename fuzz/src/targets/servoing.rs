//! A whole task under any sequence of frames, targets, settings, words and times.

use std::time::Duration;

use domvs_proto::frame::{DepthFormat, FrameHeader, HEADER_BYTES, PixelFormat};
use domvs_proto::messages::Control;
use domvs_proto::settings::{Camera, TaskSettings};
use domvs_proto::status::Status;
use domvs_server::decode::DecodeLimits;
use domvs_server::pipeline::on_frame;
use domvs_server::task::{Frame, Route, Task};

const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 12, max_bytes: 1 << 16 };
const SIDE: u32 = 24;
const MOST_STEPS: usize = 40;

/// The next bytes, 0 behind the end.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn byte(&mut self) -> u8 {
        self.take(1).first().copied().unwrap_or(0)
    }

    fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        taken
    }
}

/// One byte says what is done, the bytes after it with what. Every twist is finite, within the limits, zero unless servoing.
pub fn task(data: &[u8]) {
    let mut bytes = Bytes(data);
    let middle = f64::from(SIDE - 1) / 2.0;
    let camera = Camera { fx: 30.0, fy: 30.0, cx: middle, cy: middle, width: SIDE, height: SIDE, distortion: None };
    let mut task = Task::new(TaskSettings::new(camera), LIMITS);
    let mut now = Duration::from_secs(1);
    for _ in 0..MOST_STEPS {
        if bytes.0.is_empty() {
            break;
        }
        match bytes.byte() % 8 {
            0 => {
                let words = [Control::Start, Control::Pause, Control::Resume, Control::Stop];
                let _ = task.control(words[usize::from(bytes.byte() % 4)]);
            }
            1 => {
                let (header, payload) = frame(&mut bytes, task.settings());
                let _ = task.set_target(&as_frame(&header, &payload, now, Route::Requested));
            }
            2 => {
                let length = usize::from(bytes.byte());
                if let Ok(patch) = serde_json::from_slice(bytes.take(length)) {
                    let _ = task.change_settings(&patch);
                }
            }
            3 => now += Duration::from_millis(8 * u64::from(bytes.byte())),
            4 => task.latch([Status::Stopped, Status::ClientLost, Status::Internal][usize::from(bytes.byte() % 3)]),
            way => {
                let route = if way == 5 { Route::Pushed } else { Route::Requested };
                let (header, payload) = frame(&mut bytes, task.settings());
                step(&mut task, &as_frame(&header, &payload, now, route), now);
            }
        }
    }
}

fn step(task: &mut Task, frame: &Frame<'_>, now: Duration) {
    let answer = on_frame(task, frame, now);
    let settings = task.settings();
    assert!(answer.twist.iter().all(|component| component.is_finite()), "{answer:?}");
    assert!(answer.is_servoing() || answer.twist == [0.0; 6], "{answer:?}");
    assert!(!answer.is_servoing() || task.is_running(), "{answer:?}");
    let norm = |part: &[f64]| part.iter().map(|component| component * component).sum::<f64>().sqrt();
    if let Some(limits) = settings.limits {
        // Rounding of a norm.
        let slack = 1.0 + 1e-12;
        assert!(norm(&answer.twist[..3]) <= limits.linear_m_per_s * slack, "{answer:?}");
        assert!(norm(&answer.twist[3..]) <= limits.angular_rad_per_s * slack, "{answer:?}");
    }
    for (component, free) in answer.twist.iter().zip(settings.degrees_of_freedom) {
        assert!(free || *component == 0.0, "a masked degree moves: {answer:?}");
    }
}

fn as_frame<'a>(header: &'a FrameHeader, payload: &'a [u8], received: Duration, route: Route) -> Frame<'a> {
    Frame { header, encoding: "", payload: payload.into(), received, route }
}

/// A picture made of four bytes, or a header as it comes and bytes that may fit it.
fn frame(bytes: &mut Bytes<'_>, settings: &TaskSettings) -> (FrameHeader, Vec<u8>) {
    let [kind, shift, level, extra] = [bytes.byte(), bytes.byte(), bytes.byte(), bytes.byte()];
    let (width, height) = (settings.camera.width.min(64), settings.camera.height.min(64));
    if kind & 7 == 7 {
        let header =
            FrameHeader::decode(bytes.take(HEADER_BYTES)).unwrap_or(FrameHeader::new(PixelFormat::Mono8, 1, 1));
        return (header, bytes.take(usize::from(level) << 4 | usize::from(extra)).to_vec());
    }
    let centre = f64::from(shift) / 16.0;
    let pixel = |at: u32| {
        let (x, y) = (f64::from(at % width) - centre, f64::from(at / width) - 12.0);
        f64::from(level) * (-(x * x + y * y) / 40.0).exp() + f64::from(at * u32::from(extra) % 61)
    };
    let mut header = FrameHeader { sequence: u64::from(extra), ..FrameHeader::new(PixelFormat::Mono8, width, height) };
    let mut payload: Vec<u8> = (0..width * height).map(|at| pixel(at) as u8).collect();
    if kind & 8 != 0 {
        header.capture_time_ns = u64::from(shift) << 24 | 1;
    }
    if kind & 16 != 0 {
        header = FrameHeader { pixel_format: PixelFormat::Mono32F, ..header };
        payload = payload.iter().flat_map(|gray| odd_float(*gray, kind).to_le_bytes()).collect();
    }
    if kind & 32 != 0 {
        (header.depth_format, header.depth_unit_m) = (DepthFormat::F32, 1.0);
        header.depth_offset = payload.len() as u32;
        payload.extend((0..width * height).flat_map(|at| odd_float((at % 251) as u8, level).to_le_bytes()));
    }
    (header, payload)
}

/// Mostly gray / 255 and 0.004 to 1; some values of `odd` make a few of them what no float should be.
fn odd_float(gray: u8, odd: u8) -> f32 {
    match (gray, odd >> 6) {
        (0..9, 1) => f32::NAN,
        (0..9, 2) => f32::INFINITY,
        (0..9, 3) => 3e38,
        _ => f32::from(gray) / 255.0,
    }
}
