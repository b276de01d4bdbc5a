//! Rates and sizes that the router keeps, so that one client does not slow another.

use super::put;
use crate::support::{Lab, Question, Scene, Status, next_status, started};

over_tls! {
    async fn what_comes_too_fast_or_is_too_large_is_dropped_and_orders_are_not() {
        let lab = Lab::open().await;
        let alice = lab.client("alice").await;
        let mut scene = Scene::small("coffee");
        let task = started(&alice, &scene.settings(), &scene.target()).await;
        let frame = scene.frame(1);
        let secret = task.secret().expect("told once").as_bytes().to_vec();

        const BURST: u64 = 500;
        for sequence in 1..=BURST {
            put(alice.session(), &lab.keys.frame(task.key()), &frame.clone().numbered(sequence, 0)).await;
        }
        // All of these orders come as fast as they can be answered.
        for _ in 0..20 {
            assert_eq!(task.pause().await.expect("obeyed"), Status::Paused);
            assert_ne!(task.resume().await.expect("obeyed"), Status::Paused);
        }
        let mut statuses = task.statuses().await.expect("followed");
        let status = next_status(&mut statuses, "a frame", |message| message.frames_in > 0).await;
        assert!(status.frames_in < BURST, "{} of {BURST} frames came through", status.frames_in);

        let large = Question::on(lab.keys.control(task.key())).with(vec![b' '; 5000]).attached(secret.clone());
        assert!(large.ask_all(alice.session()).await.is_empty(), "an order has 4096 bytes at most");
        let small = Question::on(lab.keys.control(task.key())).with(r#"{"do": "pause"}"#).attached(secret);
        assert_eq!(small.ask(alice.session()).await.json()["status"], "paused");
        lab.close().await;
    }
}
