//! What service, camera, robot and viewer may do, and what not.

use super::{CAMERA_FRAME, FORGED, assert_nothing_forged, forged, heard_through, put, task_on_camera};
use crate::support::{Following, Lab, Question, Scene, Status, ear, next_status};

over_tls! {
    async fn client_camera_robot_and_viewer_may_do_their_work() {
        let lab = Lab::open().await;
        let (alice, viewer) = (lab.client("alice").await, lab.client("viewer").await);
        let (camera, robot) = (lab.session("front").await, lab.session("robot").await);
        let mut scene = Scene::small("coffee");
        let task = task_on_camera(&lab, &alice, &mut scene).await;

        assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing(), "a client asks");
        let following = Following::on(&robot, lab.keys.command(task.key())).await;
        let seen = heard_through(&camera, &following, &mut scene, 2).await;
        let own = Following::on(alice.session(), lab.keys.command(task.key())).await;
        task.push(&scene.frame(seen + 1)).await.expect("the session is open");
        own.until("the twist of a frame that alice pushed", |message| message.sequence == seen + 1).await;

        assert_eq!(viewer.list_workers().await.expect("asked").len(), 1, "a viewer asks workers");
        let tasks = viewer.list_tasks().await.expect("asked");
        assert_eq!(tasks.len(), 1, "a viewer lists tasks");
        let mut statuses = viewer.statuses(task.key()).await.expect("followed");
        next_status(&mut statuses, "whatever a viewer is told", |_| true).await;

        // Whoever sees trouble may stop it.
        for who in ["viewer", "robot", "bob", "alice"] {
            let stopper = lab.client(who).await;
            stopper.stop_all().await.unwrap_or_else(|error| panic!("{who}: {error}"));
            next_status(&mut statuses, "stopped", |message| message.status == Status::Stopped).await;
            task.start().await.expect("started again");
            next_status(&mut statuses, "started", |message| message.status != Status::Stopped).await;
        }
        task.close().await.expect("closed");
        lab.close().await;
    }
}

over_tls! {
    async fn a_camera_commands_nothing_stops_nothing_and_sees_nothing() {
        let lab = Lab::open().await;
        let alice = lab.client("alice").await;
        let (camera, robot) = (lab.session("front").await, lab.session("robot").await);
        let mut scene = Scene::small("coffee");
        let task = task_on_camera(&lab, &alice, &mut scene).await;
        let command = lab.keys.command(task.key());
        let following = Following::on(&robot, command.clone()).await;
        let heard = ear(&robot, &command).await;
        let stops = ear(&robot, "domvs/stop").await;
        let seen = ear(&camera, "domvs/**").await;
        let first = heard_through(&camera, &following, &mut scene, 1).await;

        for key in [command.as_str(), "domvs/task/alice/**"] {
            camera.put(key, forged()).await.expect("the session is open");
        }
        camera.put("domvs/stop", "stop").await.expect("the session is open");
        camera.put("domvs/camera/other/frame", "another's").await.expect("the session is open");
        put(&camera, &lab.keys.frame(task.key()), &scene.frame(FORGED[1])).await;
        let asked = Question::on(lab.keys.control(task.key())).with(r#"{"do": "stop"}"#);
        let secret = task.secret().expect("told once");
        assert!(asked.attached(secret.as_bytes()).ask_all(&camera).await.is_empty(), "no order");
        assert!(Question::on("domvs/worker/*/info").ask_all(&camera).await.is_empty(), "no question");
        heard_through(&camera, &following, &mut scene, first + 1).await;

        assert_nothing_forged(&heard).await;
        assert!(stops.is_empty(), "the camera's stop came through");
        assert!(seen.is_empty(), "a camera hears nobody");
        assert!(task.twist(&scene.frame(2000)).await.expect("answered").is_servoing(), "nothing was stopped");
        lab.close().await;
    }
}

over_tls! {
    async fn viewer_and_robot_make_no_task_give_no_order_and_send_nothing_but_a_stop() {
        let lab = Lab::open().await;
        let alice = lab.client("alice").await;
        let (camera, listener) = (lab.session("front").await, lab.session("robot").await);
        let mut scene = Scene::small("coffee");
        let task = task_on_camera(&lab, &alice, &mut scene).await;
        let following = Following::on(&listener, lab.keys.command(task.key())).await;
        let heard = ear(&listener, &lab.keys.command(task.key())).await;
        let first = heard_through(&camera, &following, &mut scene, 1).await;

        let settings = serde_json::to_vec(&scene.settings()).expect("JSON");
        let secret = task.secret().expect("told once").as_bytes().to_vec();
        for who in ["viewer", "robot"] {
            let session = lab.session(who).await;
            for client in ["alice", who] {
                let create = Question::on(format!("domvs/worker/w1/create/{client}")).with(settings.clone());
                assert!(create.ask_all(&session).await.is_empty(), "{who} creates as {client}");
            }
            for leaf in ["twist", "target", "settings", "control", "state"] {
                let asked = Question::on(format!("domvs/task/{}/{leaf}", task.key())).with(r#"{"do": "stop"}"#);
                assert!(asked.attached(secret.clone()).ask_all(&session).await.is_empty(), "{who} asks {leaf}");
            }
            session.put(lab.keys.command(task.key()), forged()).await.expect("the session is open");
            put(&session, &lab.keys.frame(task.key()), &scene.frame(FORGED[1])).await;
            put(&session, CAMERA_FRAME, &scene.frame(FORGED[1])).await;
            // Allowed, on the same way: it arrives, so the others would have.
            session.put("domvs/stop", who).await.expect("the session is open");
            following.until("stopped", |message| message.status == Status::Stopped).await;
            task.start().await.expect("started again");
            following.until("started", |message| message.status != Status::Stopped).await;
        }
        heard_through(&camera, &following, &mut scene, first + 1).await;
        assert_nothing_forged(&heard).await;
        lab.close().await;
    }
}

over_tls! {
    async fn the_routers_own_space_is_read_by_viewers_alone_and_changed_by_nobody() {
        let lab = Lab::open().await;
        let (viewer, alice) = (lab.session("viewer").await, lab.session("alice").await);
        let service = lab.session("service").await;
        let router = viewer.info().routers_zid().await.next().expect("a router");
        let about = Question::on(format!("@/{router}/router")).ask(&viewer).await.json();
        assert_eq!(about["zid"], router.to_string());
        for session in [&alice, &service] {
            assert!(Question::on(format!("@/{router}/router")).ask_all(session).await.is_empty());
        }
        for session in [&viewer, &alice, &service] {
            let open = format!("@/{router}/router/config/access_control/default_permission");
            session.put(open, r#""allow""#).await.expect("the session is open");
        }
        // On the same way as the puts: after its answer they have been refused.
        Question::on(format!("@/{router}/router")).ask(&viewer).await;
        assert!(Question::on("domvs/worker/w1/info").ask_all(&lab.session("robot").await).await.is_empty());
        lab.close().await;
    }
}
