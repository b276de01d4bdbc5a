//! Alice and bob, whom the router keeps apart.

use super::{CAMERA_FRAME, assert_nothing_forged, forged};
use crate::support::{Lab, Question, Scene, ear, started};

over_tls! {
    async fn a_tenant_reaches_nothing_of_anothers_even_with_the_secret() {
        let lab = Lab::open().await;
        let (alice, bob) = (lab.client("alice").await, lab.client("bob").await);
        let robot = lab.session("robot").await;
        let mut scene = Scene::small("coffee");
        let task = started(&alice, &scene.settings(), &scene.target()).await;
        let secret = task.secret().expect("told once").as_bytes().to_vec();
        let heard: Vec<_> = [
            ear(bob.session(), "domvs/task/alice/**").await,
            ear(bob.session(), "domvs/task/**").await,
            ear(bob.session(), "domvs/**").await,
            ear(bob.session(), &lab.keys.status(task.key())).await,
        ]
        .into();
        let commands = ear(&robot, &lab.keys.command(task.key())).await;

        for leaf in ["twist", "target", "settings", "control", "state"] {
            for selector in [format!("domvs/task/{}/{leaf}", task.key()), format!("domvs/task/*/*/{leaf}")] {
                let asked = Question::on(selector).with(r#"{"do": "stop"}"#).attached(secret.clone());
                assert!(asked.ask_all(bob.session()).await.is_empty(), "bob asks {leaf}");
            }
        }
        let settings = serde_json::to_vec(&scene.settings()).expect("JSON");
        let created = Question::on("domvs/worker/w1/create/alice").with(settings).ask_all(bob.session()).await;
        assert!(created.is_empty(), "bob creates in the name of alice");
        bob.session().put(lab.keys.command(task.key()), forged()).await.expect("the session is open");
        alice.session().put(lab.keys.command(task.key()), forged()).await.expect("the session is open");
        bob.session().put(CAMERA_FRAME, forged()).await.expect("the session is open");
        // A false worker, which alice would choose as it has no load.
        let false_worker = |query: zenoh::query::Query| drop(query);
        for key in ["domvs/worker/evil/info", &lab.keys.twist(task.key())] {
            bob.session()
                .declare_queryable(key.to_owned())
                .complete(true)
                .callback(false_worker)
                .background()
                .await
                .expect("a fine key");
        }
        let false_token = bob.session().liveliness().declare_token("domvs/client/mallory/alive").await.expect("a fine key");

        // Bob's own task works, and by the time it does all that came before it has been refused.
        let own = started(&bob, &scene.settings(), &scene.target()).await;
        assert!(own.twist(&scene.frame(1)).await.expect("answered").is_servoing());
        assert!(task.twist(&scene.frame(2)).await.expect("answered").is_servoing(), "alice's task goes on");
        let viewer = lab.session("viewer").await;
        let mut clients: Vec<String> = vec![];
        let tokens = viewer.liveliness().get("domvs/client/*/alive").await.expect("the session is open");
        while let Ok(token) = tokens.recv_async().await {
            clients.push(token.into_result().expect("a token").key_expr().to_string());
        }
        clients.sort();
        assert_eq!(clients, ["domvs/client/alice/alive", "domvs/client/bob/alive"], "each holds the lease of its own name");
        assert_eq!(alice.list_workers().await.expect("asked").len(), 1);
        for ear in heard {
            let foreign = ear.drain().map(|sample| sample.key_expr().to_string()).find(|key| !key.contains("/bob/"));
            assert_eq!(foreign, None, "bob hears");
        }
        assert_nothing_forged(&commands).await;
        drop(false_token);
        lab.close().await;
    }
}
