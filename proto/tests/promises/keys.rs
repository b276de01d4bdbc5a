//! Keys: what is built is parsed again, and nothing that could change the routing gets in.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use domvs_proto::keys::{KeyError, Keys, Leaf, Name, TaskKey};

fn name(text: &str) -> Name {
    Name::try_from(text).unwrap()
}

fn task() -> TaskKey {
    "alice/t-1".parse().unwrap()
}

#[test]
fn keys_are_those_of_the_design() {
    let keys = Keys::new("domvs").unwrap();
    let (w, a) = (name("w1"), name("alice"));
    assert_eq!(keys, Keys::default());
    assert_eq!(keys.worker_alive(&w), "domvs/worker/w1/alive");
    assert_eq!(keys.workers_alive(), "domvs/worker/*/alive");
    assert_eq!(keys.worker_info(&w), "domvs/worker/w1/info");
    assert_eq!(keys.workers_info(), "domvs/worker/*/info");
    assert_eq!(keys.create(&w, &a), "domvs/worker/w1/create/alice");
    assert_eq!(keys.creates(&w), "domvs/worker/w1/create/*");
    assert_eq!(keys.owner(&task(), &w, 65_578), "domvs/task/alice/t-1/owner/w1/65578");
    assert_eq!(keys.owners(), "domvs/task/*/*/owner/**");
    assert_eq!(keys.owners_of(&task()), "domvs/task/alice/t-1/owner/**");
    assert_eq!(keys.target(&task()), "domvs/task/alice/t-1/target");
    assert_eq!(keys.twist(&task()), "domvs/task/alice/t-1/twist");
    assert_eq!(keys.frame(&task()), "domvs/task/alice/t-1/frame");
    assert_eq!(keys.command(&task()), "domvs/task/alice/t-1/command");
    assert_eq!(keys.status(&task()), "domvs/task/alice/t-1/status");
    assert_eq!(keys.settings(&task()), "domvs/task/alice/t-1/settings");
    assert_eq!(keys.control(&task()), "domvs/task/alice/t-1/control");
    assert_eq!(keys.state(&task()), "domvs/task/alice/t-1/state");
    assert_eq!(keys.tasks(), "domvs/task/**");
    assert_eq!(keys.commands(), "domvs/task/*/*/command");
    assert_eq!(keys.statuses(), "domvs/task/*/*/status");
    assert_eq!(keys.client_alive(&a), "domvs/client/alice/alive");
    assert_eq!(keys.clients_alive(), "domvs/client/*/alive");
    assert_eq!(keys.camera_frame(&a), "domvs/camera/alice/frame");
    assert_eq!(keys.camera_info(&a), "domvs/camera/alice/info");
    assert_eq!(keys.camera_desired(&a), "domvs/camera/alice/desired");
    assert_eq!(keys.camera_alive(&a), "domvs/camera/alice/alive");
    assert_eq!(keys.cameras_alive(), "domvs/camera/*/alive");
    assert_eq!(keys.stop(), "domvs/stop");
}

#[test]
fn what_is_built_is_parsed_again() {
    for prefix in ["domvs", "site-4/cell_2"] {
        let keys = Keys::new(prefix).unwrap();
        let (w, a) = (name("w1"), name("alice"));
        assert_eq!(keys.parse_create(&keys.create(&w, &a)), Some((w.clone(), a.clone())));
        assert_eq!(keys.parse_worker_alive(&keys.worker_alive(&w)), Some(w.clone()));
        assert_eq!(keys.parse_client_alive(&keys.client_alive(&a)), Some(a.clone()));
        assert_eq!(keys.parse_camera_alive(&keys.camera_alive(&a)), Some(a));
        assert_eq!(keys.parse_owner(&keys.owner(&task(), &w, u32::MAX)), Some((task(), w, u32::MAX)));
        for leaf in Leaf::ALL {
            assert_eq!(keys.parse_task(&keys.task(&task(), leaf)), Some((task(), leaf)));
            assert_eq!(keys.split_task(&keys.task(&task(), leaf)), Some((task().to_string().as_str(), leaf)));
        }
    }
}

#[test]
fn foreign_keys_are_not_parsed() {
    let keys = Keys::default();
    for key in [
        "",
        "domvs",
        "domvs/",
        "domvsx/task/a/b/twist",
        "other/task/a/b/twist",
        "domvs//task/a/b/twist",
        "domvs/task/a/b",
        "domvs/task/a/b/twist/",
        "domvs/task/a/b/other",
        "domvs/task/a/*/twist",
        "domvs/task/a b/c/twist",
    ] {
        assert_eq!(keys.parse_task(key), None, "{key}");
    }
    for key in [
        "domvs/task/a/b/owner/w",
        "domvs/task/a/b/owner/w/-1",
        "domvs/task/a/b/owner/w/4294967296",
        "domvs/task/a/b/owner/w/+1",
        "domvs/task/a/b/owner/w/01",
        "domvs/task/a/b/owner/w/1/2",
    ] {
        assert_eq!(keys.parse_owner(key), None, "{key}");
    }
    assert_eq!(keys.parse_create("domvs/worker/w/create/a/b"), None);
    assert_eq!(keys.parse_create("domvs/worker/w/create/"), None);
    assert_eq!(keys.parse_client_alive("domvs/client/**/alive"), None);
    assert_eq!(keys.parse_worker_alive("domvs/worker/w/info"), None);
}

#[test]
fn a_name_holds_nothing_that_routes() {
    for text in ["a/b", "*", "**", "a$*", "@v1", "a?b", "a#b", "a b", "ä", "a\0", "a.b", "a\n", "%2F"] {
        assert!(matches!(Name::try_from(text), Err(KeyError::NameCharacter { .. })), "{text:?}");
    }
    assert_eq!(Name::try_from(""), Err(KeyError::NameLength { got_bytes: 0 }));
    assert_eq!(Name::try_from("x".repeat(65).as_str()), Err(KeyError::NameLength { got_bytes: 65 }));
    assert!(Name::try_from("x".repeat(64).as_str()).is_ok());
    assert!(serde_json::from_str::<Name>("\"a/b\"").is_err());
}

#[test]
fn a_task_is_two_names() {
    assert_eq!(task().to_string(), "alice/t-1");
    for text in ["", "alice", "alice/", "/t", "a/b/c", "*/t"] {
        assert!(text.parse::<TaskKey>().is_err(), "{text:?}");
    }
}

#[test]
fn a_prefix_is_made_of_names() {
    for prefix in ["", "/domvs", "domvs/", "a//b", "a/*", "@a"] {
        assert!(Keys::new(prefix).is_err(), "{prefix:?}");
    }
    assert_eq!(Keys::new("a/b").unwrap().stop(), "a/b/stop");
}
