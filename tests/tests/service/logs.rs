//! No secret stands in a log: everything that client, worker, router and Zenoh say at the most talkative level, while tasks are made, controlled
//! and asked with secrets, over links with passwords and keys. What is said goes to a process, so a process says it: this test binary, once more.

use std::fmt::Write;

use domvs::log::{LogFormat, subscriber};
use domvs_client::Secret;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::util::SubscriberInitExt;

use crate::support::{ErrorCode, Following, Lab, Question, Scene, alone, code, push, started};

/// Names the file to which the talking process writes what it knew.
const KNOWN: &str = "DOMVS_TEST_KNOWN";

#[test]
fn no_secret_password_or_key_is_logged_at_any_level() {
    let folder = tempfile::tempdir().expect("a folder");
    let known = folder.path().join("known");
    // The command's own filter, as far open as it goes.
    let environment = [(KNOWN, known.as_os_str()), ("RUST_LOG", "trace".as_ref())];
    let talking = alone("logs::everything_is_said", &environment);
    let said = String::from_utf8_lossy(&talking.stderr);
    assert!(talking.status.success(), "{said}");
    for who in ["zenoh", "rustls", "domvs_server"] {
        assert!(said.lines().any(|line| line.contains(who)), "{who} says nothing");
    }
    assert!(said.contains("TRACE"), "not at the most talkative level");

    let known = std::fs::read_to_string(&known).expect("written");
    for line in known.lines() {
        let (what, text) = line.split_once('\t').expect("what and text");
        let line = said.lines().find(|said| said.contains(text));
        assert!(line.is_none(), "{what} is logged: {}", line.unwrap_or_default().chars().take(400).collect::<String>());
    }
    assert!(known.lines().count() > 10, "{} things to look for", known.lines().count());
}

/// The forms in which 16 bytes could be written.
fn forms(secret: &Secret) -> [String; 4] {
    let bytes = secret.as_bytes();
    let decimal: Vec<String> = bytes.iter().map(u8::to_string).collect();
    let mut spaced = String::new();
    for byte in bytes {
        write!(spaced, "{byte:02x} ").expect("a string has room");
    }
    [secret.to_hex(), secret.to_hex().to_uppercase(), decimal.join(", "), spaced.trim_end().to_owned()]
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "talks; the test above listens"]
async fn everything_is_said() {
    let Some(known) = std::env::var_os(KNOWN) else { return };
    subscriber(EnvFilter::from_default_env(), LogFormat::Text, std::io::stderr, false).init();

    let lab = Lab::open().await;
    let alice = lab.client("alice").await;
    let mut scene = Scene::small("coffee");
    let task = started(&alice, &scene.settings(), &scene.target()).await;
    let secret = task.secret().expect("told once").clone();
    assert!(task.twist(&scene.frame(1)).await.expect("answered").is_servoing());
    let following = Following::on(alice.session(), lab.keys.command(task.key())).await;
    push(&task, &following, &scene.frame(2)).await;
    task.change_settings(&serde_json::json!({ "order": 6 })).await.expect("changed");
    task.target().await.expect("told");
    task.state().await.expect("told");
    task.pause().await.expect("obeyed");
    // Nearly right, and in a place where it does not belong.
    let wrong = Secret::new(std::array::from_fn(|i| secret.as_bytes()[i] ^ u8::from(i == 15)));
    let question = Question::on(lab.keys.control(task.key())).with(r#"{"do": "stop"}"#);
    assert_eq!(code(question.clone().attached(wrong.as_bytes()).ask(alice.session()).await), ErrorCode::NotOwner);
    let body = format!(r#"{{"do": "stop", "secret": "{}"}}"#, secret.to_hex());
    code(Question::on(lab.keys.control(task.key())).with(body).attached(secret.as_bytes()).ask(alice.session()).await);
    let asked = Question::on(lab.keys.control(task.key())).with(secret.as_bytes()).attached(secret.as_bytes());
    code(asked.ask(alice.session()).await);
    let shown = format!("{secret:?} {task:?} {:?}", scene.frame(3));
    task.close().await.expect("closed");

    let mut known_text = String::new();
    let mut know = |what: &str, text: &str| writeln!(known_text, "{what}\t{text}").expect("a string has room");
    for form in forms(&secret).into_iter().chain(forms(&wrong)) {
        assert!(!shown.contains(&form), "{shown}");
        know("a task's secret", &form);
    }
    let users = std::fs::read_to_string(lab.folder.path().join("users.txt")).expect("it is there");
    users.lines().for_each(|line| know("a password", line.split_once(':').expect("name and password").1));
    for name in ["ca", "router", "service", "alice"] {
        let key = std::fs::read_to_string(lab.folder.path().join(format!("{name}.key.pem"))).expect("it is there");
        know("a private key", key.lines().nth(1).expect("a body"));
    }
    lab.close().await;
    std::fs::write(known, known_text).expect("a writable folder");
}
