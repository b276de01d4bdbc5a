//! What a task of 640x480 pixels holds while it lives, and that nothing is left of it.

use std::time::Duration;

use domvs_proto::frame::{DepthFormat, PixelFormat, RAW};
use domvs_proto::messages::Control;
use domvs_proto::settings::{Method, TaskSettings};
use domvs_server::decode::DecodeLimits;
use domvs_server::payload::Payload;
use domvs_server::pipeline::on_frame;
use domvs_server::task::{Frame, Route, Task};

use crate::live_bytes;
use crate::pictures::{picture, settings};

const SIZE: [u32; 2] = [640, 480];
/// What a task may hold, bytes.
const MOST: isize = 40 << 20;

pub fn a_task_gives_its_memory_back() {
    let formats = PixelFormat::ALL.into_iter().filter(|format| *format != PixelFormat::ByEncoding);
    let numbered = formats.zip(2..).map(|(format, number)| picture(format, DepthFormat::U16, SIZE, number));
    let frames: Vec<_> = numbered.collect();
    let target = picture(PixelFormat::Mono32F, DepthFormat::F32, SIZE, 0);
    for method in Method::ALL {
        let before = live_bytes();
        let limits = DecodeLimits { max_pixels: 1 << 20, max_bytes: 1 << 24 };
        let mut task = Task::new(TaskSettings { method, ..settings(SIZE[0], SIZE[1]) }, limits);
        let frame = |header, payload, route| Frame {
            header,
            encoding: RAW,
            payload: Payload::Pieces(payload),
            received: Duration::ZERO,
            route,
        };
        task.set_target(&frame(&target.0, &target.1, Route::Requested)).expect("a target");
        task.control(Control::Start).expect("a start");
        for route in [Route::Requested, Route::Pushed] {
            for (header, payload) in &frames {
                assert!(on_frame(&mut task, &frame(header, payload, route), Duration::ZERO).is_servoing());
            }
        }
        let held = live_bytes() - before;
        println!("{}: {:.1} MB for 640x480 with a depth map", method.word(), held as f64 / 1e6);
        assert!(held <= MOST, "{}: {held} bytes", method.word());
        drop(task);
        assert_eq!(live_bytes(), before, "{}", method.word());
    }
}
