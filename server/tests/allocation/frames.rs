//! From the bytes that came to the bytes that leave, without a network.

use std::time::Duration;

use domvs_proto::frame::{DepthFormat, FrameHeader, JPEG, PNG, PixelFormat, RAW};
use domvs_proto::messages::Control;
use domvs_proto::settings::{Method, TaskSettings};
use domvs_server::decode::DecodeLimits;
use domvs_server::payload::{Payload, header_of};
use domvs_server::pipeline::on_frame;
use domvs_server::task::{Frame, Route, Task};
use domvs_server::{AccelerationLimits, Governor};
use domvs_vision::Twist;
use image::ImageEncoder;
use zenoh::bytes::ZBytes;

use crate::allocations;
use crate::pictures::{gray, in_packets, picture, settings};

/// More than a network packet, so that rows lie across two of them.
const SIZE: [u32; 2] = [322, 250];
const LIMITS: DecodeLimits = DecodeLimits { max_pixels: 1 << 20, max_bytes: 1 << 24 };
const PERIOD: Duration = Duration::from_millis(66);
/// Frames before the steady ones.
const FIRST: u64 = 4;
const STEADY: u64 = 6;

/// A frame as it came: attachment, Encoding, payload.
struct Came {
    attachment: ZBytes,
    encoding: &'static str,
    payload: ZBytes,
}

impl Came {
    fn new((header, payload): (FrameHeader, ZBytes), encoding: &'static str) -> Came {
        Came { attachment: in_packets(&header.encode()), encoding, payload }
    }
}

/// A task, and what stands between it and `command`.
struct Way {
    task: Task,
    governor: Governor,
    now: Duration,
}

impl Way {
    fn new(settings: TaskSettings, target: &Came) -> Way {
        let limits = AccelerationLimits { linear_m_per_s2: 0.5, angular_rad_per_s2: 2.0 };
        let governor = Governor::new(Some(limits), PERIOD, PERIOD);
        let mut way = Way { task: Task::new(settings, LIMITS), governor, now: Duration::ZERO };
        let header = header_of(Some(&target.attachment)).expect("a true header");
        let frame = way.frame(&header, target, Route::Requested);
        way.task.set_target(&frame).expect("a target");
        way.task.control(Control::Start).expect("a start");
        way
    }

    fn frame<'a>(&self, header: &'a FrameHeader, came: &'a Came, route: Route) -> Frame<'a> {
        let payload = Payload::from(&came.payload);
        Frame { header, encoding: came.encoding, payload, received: self.now, route }
    }

    /// From the bytes that came to the bytes that leave.
    fn answer(&mut self, came: &Came, route: Route) -> [u8; 128] {
        self.now += PERIOD;
        let header = header_of(Some(&came.attachment)).expect("a true header");
        let frame = self.frame(&header, came, route);
        let mut answer = on_frame(&mut self.task, &frame, self.now);
        assert!(answer.is_servoing(), "{:?}: {:?}", answer.status, self.task.detail());
        if route == Route::Pushed {
            let governed = self.governor.pass(Twist::from_array(answer.twist), self.now, self.now);
            answer.twist = governed.twist.to_array();
            self.task.commanded(governed.twist);
        }
        self.task.told(Twist::from_array(answer.twist));
        answer.encode()
    }

    /// Allocations of each steady frame.
    fn steady(&mut self, frames: &[Came], route: Route) -> Vec<usize> {
        let (first, steady) = frames.split_at(FIRST as usize);
        first.iter().for_each(|came| _ = self.answer(came, route));
        // Made before the counting begins.
        let mut counts = vec![0; steady.len()];
        for (count, came) in counts.iter_mut().zip(steady) {
            *count = allocations(|| self.answer(came, route)).0;
        }
        counts
    }
}

fn pictures(format: PixelFormat, depth: DepthFormat) -> Vec<Came> {
    (1..=FIRST + STEADY).map(|number| Came::new(picture(format, depth, SIZE, number), RAW)).collect()
}

pub fn raw_formats_allocate_nothing() {
    for format in PixelFormat::ALL.into_iter().filter(|format| *format != PixelFormat::ByEncoding) {
        for depth in DepthFormat::ALL {
            for route in [Route::Requested, Route::Pushed] {
                let mut settings = settings(SIZE[0], SIZE[1]);
                if depth == DepthFormat::None {
                    settings.depth = domvs_proto::settings::Depth::ConstantM(1.0);
                }
                let target = Came::new(picture(format, depth, SIZE, 0), RAW);
                let counts = Way::new(settings, &target).steady(&pictures(format, depth), route);
                assert_eq!(counts, [0; STEADY as usize], "{format:?}, depth {depth:?}, {route:?}");
            }
        }
    }
}

pub fn methods_allocate_nothing() {
    for method in Method::ALL {
        let settings = TaskSettings { method, ..settings(SIZE[0], SIZE[1]) };
        let target = Came::new(picture(PixelFormat::Mono8, DepthFormat::U16, SIZE, 0), RAW);
        let counts = Way::new(settings, &target).steady(&pictures(PixelFormat::Mono8, DepthFormat::U16), Route::Pushed);
        assert_eq!(counts, [0; STEADY as usize], "{method:?}");
    }
}

/// What the decoders of PNG and JPEG take for themselves each time: some tens of allocations, however large the picture.
pub fn files_allocate_little() {
    for encoding in [PNG, JPEG] {
        let mut settings = settings(SIZE[0], SIZE[1]);
        settings.depth = domvs_proto::settings::Depth::ConstantM(1.0);
        let frames: Vec<Came> = (1..=FIRST + STEADY).map(|number| file(encoding, number)).collect();
        let counts = Way::new(settings, &file(encoding, 0)).steady(&frames, Route::Requested);
        println!("{encoding}: {counts:?} allocations a frame");
        assert!(counts.iter().all(|count| *count < 200), "{encoding}: {counts:?}");
    }
}

fn file(encoding: &'static str, number: u64) -> Came {
    let [width, height] = SIZE;
    let levels: Vec<u8> = (0..width * height).map(|at| (255.0 * gray(at % width, at / width, number)) as u8).collect();
    let mut bytes = Vec::new();
    let color = image::ExtendedColorType::L8;
    match encoding {
        PNG => image::codecs::png::PngEncoder::new(&mut bytes).write_image(&levels, width, height, color),
        _ => image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90).encode(&levels, width, height, color),
    }
    .expect("a fine picture");
    let header = FrameHeader { sequence: number, ..FrameHeader::new(PixelFormat::ByEncoding, width, height) };
    Came::new((header, in_packets(&bytes)), encoding)
}
