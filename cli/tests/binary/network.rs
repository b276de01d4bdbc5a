//! Three terminals: service, simulated camera and client are three processes that meet over TCP on the loopback.

use std::net::TcpListener;
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

/// A child that does not outlive its test.
struct Background(Child);

impl Drop for Background {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A service on a port of its own.
pub struct Place {
    pub endpoint: String,
    service: Background,
}

impl Place {
    pub fn start() -> Place {
        let port = TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap();
        let endpoint = format!("tcp/{port}");
        let service = spawn(&["serve", "--listen", &endpoint]);
        Place { endpoint, service }
    }

    /// The service's number among the processes.
    pub fn process(&self) -> u32 {
        self.service.0.id()
    }

    fn run(&self, arguments: &[&str]) -> Output {
        domvs(arguments).args(["-e", &self.endpoint]).output().unwrap()
    }

    /// Repeats a command until it succeeds: the service may still be starting.
    fn insist(&self, arguments: &[&str]) -> String {
        const ATTEMPTS: usize = 10;
        let mut last = String::new();
        for _ in 0..ATTEMPTS {
            let output = self.run(arguments);
            if output.status.success() {
                return String::from_utf8(output.stdout).unwrap();
            }
            last = String::from_utf8_lossy(&output.stderr).into_owned();
        }
        panic!("{arguments:?} failed {ATTEMPTS} times: {last}");
    }
}

fn domvs(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_domvs"));
    command.args(arguments);
    command
}

fn spawn(arguments: &[&str]) -> Background {
    Background(domvs(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

const CAMERA: &str = r#"{"camera": {"fx": 100, "fy": 100, "cx": 63.5, "cy": 63.5, "width": 128, "height": 128}}"#;

#[test]
fn three_processes_bring_the_camera_there() {
    let place = Place::start();
    let flight = ["sim", "camera", "--size", "128x128", "--displacement", "0.05,-0.03,-0.05,-1,-2,-4", "-e"];
    let _camera = spawn(&[&flight[..], &[&place.endpoint]].concat());
    let said = place.insist(&["task", "run", "--json", "--settings", r#"{"gain": {"per_s": 3}}"#]);
    let last: Value = serde_json::from_str(said.trim()).unwrap();
    assert_eq!(last["status"], "converged", "{last}");
    assert_eq!(last["twist"], serde_json::json!([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn a_run_without_an_end_gives_up_and_says_so_by_its_exit_code() {
    let place = Place::start();
    let flight = ["sim", "camera", "--size", "96x96", "--follow", "nobody", "-e"];
    let _camera = spawn(&[&flight[..], &[&place.endpoint]].concat());
    place.insist(&["task", "list"]);
    let run = ["task", "run", "--seconds", "0.5", "--settings", r#"{"stop": {"max_iterations": 1000}}"#];
    let mut output = place.run(&run);
    // The camera may still be on its way to the service.
    for _ in 0..5 {
        if output.status.code() != Some(1) {
            break;
        }
        output = place.run(&run);
    }
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_second_client_of_the_same_name_is_refused() {
    let place = Place::start();
    let flight = ["sim", "camera", "--size", "96x96", "--follow", "nobody", "-e"];
    let _camera = spawn(&[&flight[..], &[&place.endpoint]].concat());
    place.insist(&["task", "list"]);
    let _first = spawn(&["task", "run", "--client", "twin", "-e", &place.endpoint]);
    // The first one is there when its task is.
    let running = (0..200).any(|_| place.insist(&["task", "list"]).contains("twin/"));
    assert!(running, "the first run never made its task");
    let second = place.run(&["task", "run", "--client", "twin"]);
    assert_eq!(second.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&second.stderr).contains("--client"));
}

#[test]
fn a_task_is_made_used_and_closed_from_one_terminal_after_another() {
    let place = Place::start();
    let made: Value = serde_json::from_str(&place.insist(&["task", "create", CAMERA])).unwrap();
    let (task, secret) = (made["task"].as_str().unwrap(), made["secret"].as_str().unwrap());
    let owned = |word: &str| place.run(&["task", word, task, "--secret", secret]);

    let listed = place.insist(&["task", "list", "--json"]);
    assert!(listed.contains(task) && listed.contains("waiting_target"), "{listed}");
    let refused = owned("start");
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("no_target"));

    let folder = tempfile::tempdir().unwrap();
    let (desired, saved) = (folder.path().join("desired.png"), folder.path().join("saved.png"));
    image::GrayImage::from_fn(128, 128, |u, v| image::Luma([(u * 2 + v / 2) as u8])).save(&desired).unwrap();
    let with_file = |option: &str, file: &std::path::Path| {
        place.run(&["task", "target", task, "--secret", secret, option, file.to_str().unwrap()])
    };
    assert_eq!(String::from_utf8(with_file("--desired", &desired).stdout).unwrap().trim(), "ready");
    assert!(with_file("--save", &saved).status.success());
    assert_eq!(std::fs::read(&saved).unwrap(), std::fs::read(&desired).unwrap());

    assert_eq!(String::from_utf8(owned("start").stdout).unwrap().trim(), "waiting_frame");
    assert!(place.run(&["stop", "--all"]).status.success());
    let status = place.insist(&["task", "status", task, "--json"]);
    assert!(status.contains("stopped"), "{status}");
    assert!(owned("close").status.success());
    assert_eq!(place.insist(&["task", "list"]).trim(), "no tasks");
}

#[test]
fn a_wrong_secret_is_refused_by_name() {
    let place = Place::start();
    let made: Value = serde_json::from_str(&place.insist(&["task", "create", CAMERA])).unwrap();
    let stranger = "00".repeat(16);
    let output = place.run(&["task", "stop", made["task"].as_str().unwrap(), "--secret", &stranger]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("not_owner"));
}
