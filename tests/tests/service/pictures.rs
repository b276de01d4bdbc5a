//! Pictures and depths that nothing should move by: each has its status, a zero twist, and the next good frame moves again.

use domvs_client::{DepthPlane, OutgoingFrame, PixelFormat};
use domvs_proto::settings::{Depth, Frames, Holes};
use domvs_simulators::Rendering;

use crate::support::{
    ErrorCode, Following, Scene, Stage, Status, TaskSettings, ZEROS, gray8, next_status, push, refusal, started,
};

fn flat(gray: f32, [width, height]: [usize; 2]) -> OutgoingFrame {
    let pixels: Vec<u8> = gray.to_le_bytes().repeat(width * height);
    let depth = vec![1.0; width * height];
    let depth = DepthPlane::Metres(&depth);
    OutgoingFrame::raw_with_depth(PixelFormat::Mono32F, width as u32, height as u32, pixels, depth).expect("fine")
}

/// The rendering with this depth in the first of every so many pixels; the others keep theirs.
fn with_holes(rendering: &Rendering, every: usize, hole: f32) -> OutgoingFrame {
    let mut depth = rendering.depth.samples().to_vec();
    depth.iter_mut().step_by(every).for_each(|metres| *metres = hole);
    with_depth(rendering, &depth)
}

fn with_depth(rendering: &Rendering, depth: &[f32]) -> OutgoingFrame {
    let (width, height) = (rendering.image.width() as u32, rendering.image.height() as u32);
    let depth = DepthPlane::Metres(depth);
    OutgoingFrame::raw_with_depth(PixelFormat::Mono8, width, height, gray8(rendering), depth).expect("true lengths")
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_that_show_nothing_move_nothing_by_either_way() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { frames: Frames::Pushed, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let following = Following::on(client.session(), stage.keys.command(task.key())).await;
    let mut statuses = task.statuses().await.expect("followed");
    let size = [scene.camera.width, scene.camera.height];
    let mostly_nan = {
        let rendering = scene.simulation.capture();
        let mut pixels: Vec<f32> = rendering.image.samples().to_vec();
        let half = pixels.len() / 2 + 1;
        pixels[..half].fill(f32::NAN);
        let bytes: Vec<u8> = pixels.iter().flat_map(|gray| gray.to_le_bytes()).collect();
        OutgoingFrame::raw(PixelFormat::Mono32F, size[0] as u32, size[1] as u32, bytes).expect("true lengths")
    };
    let cases = [
        ("black", flat(0.0, size), Status::LowTexture, "contrast"),
        ("white", flat(1.0, size), Status::LowTexture, "contrast"),
        ("gray", flat(0.5, size), Status::LowTexture, "contrast"),
        ("smaller", flat(0.5, [64, 48]), Status::BadFrame, "96x72 pixels as the target has, got 64x48"),
        ("turned", flat(0.5, [72, 96]), Status::BadFrame, "96x72 pixels as the target has, got 72x96"),
        ("half NaN", mostly_nan, Status::BadFrame, "finite"),
    ];
    let mut sequence = 0;
    for (what, frame, expected, numbers) in cases {
        sequence += 10;
        assert!(push(&task, &following, &scene.frame(sequence)).await.is_servoing(), "before {what}");
        let pushed = push(&task, &following, &frame.clone().numbered(sequence + 1, 0)).await;
        let asked = task.twist(&frame.numbered(sequence + 2, 0)).await.expect("answered");
        for answer in [pushed, asked] {
            assert_eq!((answer.status, answer.twist), (expected, ZEROS), "{what}");
        }
        let said = next_status(&mut statuses, "the status", |message| message.status == expected).await;
        let detail = said.detail.unwrap_or_default();
        assert!(detail.contains(numbers) && !said.latched, "{what}: {detail}");
        assert!(task.twist(&scene.frame(sequence + 3)).await.expect("answered").is_servoing(), "after {what}");
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_target_that_shows_nothing_or_does_not_fit_is_refused_and_the_old_one_stays() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let size = [scene.camera.width, scene.camera.height];
    for (frame, numbers) in [(flat(0.0, size), "flat"), (flat(1.0, size), "flat"), (flat(0.5, [64, 48]), "64x48")] {
        let (code, error) = refusal(task.set_target(&frame).await);
        assert!(code == ErrorCode::BadTarget && error.contains(numbers), "{error}");
    }
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_few_unknown_depths_are_filled_and_flagged_and_over_half_of_them_stop() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&client, &scene.settings(), &scene.target()).await;
    let view = scene.simulation.capture();

    let whole = task.twist(&with_depth(&view, view.depth.samples()).numbered(1, 0)).await.expect("answered");
    assert!(whole.is_servoing() && !whole.flags.depth_estimated);
    for (sequence, hole) in [(2, f32::NAN), (3, 0.0), (4, -1.0), (5, f32::INFINITY)] {
        let few = task.twist(&with_holes(&view, 50, hole).numbered(sequence, 0)).await.expect("answered");
        assert!(few.is_servoing() && few.flags.depth_estimated, "{hole}: {few:?}");
        assert!(few.twist.iter().all(|component| component.is_finite()));
    }
    let (width, height) = (view.depth.width(), view.depth.height());
    let mut mostly_unknown = view.depth.samples().to_vec();
    mostly_unknown[..width * height / 2 + 1].fill(0.0);
    let stopped = task.twist(&with_depth(&view, &mostly_unknown).numbered(6, 0)).await.expect("answered");
    assert_eq!((stopped.status, stopped.twist), (Status::NoDepth, ZEROS));
    let no_plane =
        OutgoingFrame::mono8(width as u32, height as u32, gray8(&view)).expect("true lengths").numbered(7, 0);
    assert_eq!(task.twist(&no_plane).await.expect("answered").status, Status::NoDepth);
    assert!(task.twist(&scene.frame(8)).await.expect("answered").is_servoing());
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_a_fallback_even_no_depth_at_all_servoes_and_is_flagged() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { depth: Depth::Map { fallback_m: Some(1.0), holes: Holes::Fill }, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let view = scene.simulation.capture();
    let (width, height) = (view.depth.width() as u32, view.depth.height() as u32);
    let blind = with_holes(&view, 1, f32::NAN).numbered(1, 0);
    let bare = OutgoingFrame::mono8(width, height, gray8(&view)).expect("true lengths").numbered(2, 0);
    for frame in [blind, bare] {
        let answer = task.twist(&frame).await.expect("answered");
        assert!(answer.is_servoing() && answer.flags.depth_estimated, "{answer:?}");
        assert_ne!(answer.twist, ZEROS);
    }
    stage.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_targets_depth_serves_frames_that_have_none() {
    let stage = Stage::open().await;
    let client = stage.client("alice").await;
    let mut scene = Scene::small("coffee");
    let settings = TaskSettings { depth: Depth::Target, ..scene.settings() };
    let task = started(&client, &settings, &scene.target()).await;
    let view = scene.simulation.capture();
    let (width, height) = (view.depth.width() as u32, view.depth.height() as u32);
    let bare = OutgoingFrame::mono8(width, height, gray8(&view)).expect("true lengths").numbered(1, 0);
    assert!(task.twist(&bare).await.expect("answered").is_servoing());
    stage.close().await;
}
