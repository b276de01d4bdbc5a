//! Pictures of a photograph on a plane, from where the camera should be and from where it is, with the true depth.

use domvs_client::{DepthPlane, OutgoingFrame, PixelFormat};
use domvs_proto::keys::TaskKey;
use domvs_proto::settings::{Camera, Depth, Holes, TaskSettings};
use domvs_simulators::{CameraSettings, Follow, Photograph, Rendering, Simulation};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::name;

/// A displacement that half a dozen steps undo.
const NEAR: [f64; 6] = [0.04, -0.03, -0.05, -1.0, -2.0, -4.0];

/// A camera in front of a photograph, and the world it moves in.
pub struct Scene {
    pub camera: CameraSettings,
    pub simulation: Simulation,
}

impl Scene {
    /// A small picture of a bundled photograph, displaced a little.
    pub fn small(photograph: &str) -> Scene {
        Scene::new(photograph, [96, 72], NEAR)
    }

    /// `displacement` is m, m, m, deg, deg, deg.
    pub fn new(photograph: &str, [width, height]: [usize; 2], displacement: [f64; 6]) -> Scene {
        let photograph = Photograph::bundled(photograph).expect("a bundled name");
        let camera = CameraSettings { width, height, displacement, ..CameraSettings::new(name("cam"), photograph) };
        let simulation = camera.simulation().expect("possible");
        Scene { camera, simulation }
    }

    /// The camera's optics.
    pub fn optics(&self) -> Camera {
        self.camera.info().expect("possible").camera
    }

    /// Depth from the frames, no limits, and a watchdog that a busy machine does not trip.
    pub fn settings(&self) -> TaskSettings {
        TaskSettings {
            depth: Depth::Map { fallback_m: None, holes: Holes::Fill },
            limits: None,
            watchdog_ms: Some(10_000),
            ..TaskSettings::new(self.optics())
        }
    }

    /// Flies by the commands of `task` and sends its frames to it, `rate_hz` times a second.
    pub fn following(&self, task: &TaskKey, frame_key: String, rate_hz: f64) -> CameraSettings {
        let follow = Follow::Task(task.clone());
        CameraSettings { follow, frame_key: Some(frame_key), rate_hz, ..self.camera.clone() }
    }

    /// What the camera should see, as 32-bit gray and depth.
    pub fn target(&mut self) -> OutgoingFrame {
        exact(&self.simulation.capture_desired())
    }

    /// What it sees, as 32-bit gray and depth.
    pub fn frame(&mut self, sequence: u64) -> OutgoingFrame {
        exact(&self.simulation.capture()).numbered(sequence, 0)
    }
}

/// Every sample as it is, 32-bit gray and depth.
pub fn exact(rendering: &Rendering) -> OutgoingFrame {
    let Rendering { image, depth, .. } = rendering;
    let pixels: Vec<u8> = image.samples().iter().flat_map(|gray| gray.to_le_bytes()).collect();
    let (width, height) = (image.width() as u32, image.height() as u32);
    let depth = DepthPlane::Metres(depth.samples());
    OutgoingFrame::raw_with_depth(PixelFormat::Mono32F, width, height, pixels, depth).expect("true lengths")
}

/// 8-bit gray of a rendering.
pub fn gray8(rendering: &Rendering) -> Vec<u8> {
    domvs_simulators::mono8(&rendering.image)
}

/// A rendering as a gray JPEG file of high quality.
pub fn jpeg(rendering: &Rendering) -> Vec<u8> {
    let (width, height) = (rendering.image.width() as u32, rendering.image.height() as u32);
    let mut bytes = vec![];
    JpegEncoder::new_with_quality(&mut bytes, 95)
        .encode(&gray8(rendering), width, height, ExtendedColorType::L8)
        .expect("a fine picture");
    bytes
}

/// Samples as a PNG file.
pub fn png(samples: &[u8], [width, height]: [u32; 2], color: ExtendedColorType) -> Vec<u8> {
    let mut bytes = vec![];
    PngEncoder::new(&mut bytes).write_image(samples, width, height, color).expect("true lengths");
    bytes
}
