//! `domvs serve` as a process: how it ends, what it says, and that nobody who stands still is waited for. An end in order that took
//! two seconds would be told by the exit code 4, so no test looks at a clock.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use domvs_client::{Client, ClientOptions, OutgoingFrame};
use domvs_proto::frame::Secret;
use domvs_proto::settings::{Camera, Depth, Lease, TaskSettings};
use serde_json::Value;

/// Longer than anything here takes on a busy machine.
const LIMIT: Duration = Duration::from_secs(30);
const SIZE: u32 = 64;

/// A service that does not outlive its test, and its endpoint.
struct Serving {
    child: Child,
    endpoint: String,
    /// Its first lines: ready, and where the metrics are.
    said: Vec<String>,
}

impl Serving {
    /// A service with these options on a port of its own; reads so many lines of what it says.
    fn start(options: &[&str], lines: usize) -> Serving {
        for _ in 0..5 {
            let port = TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap();
            let endpoint = format!("tcp/{port}");
            let mut command = Command::new(env!("CARGO_BIN_EXE_domvs"));
            command.args(["serve", "--listen", &endpoint]).args(options);
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut child = command.spawn().unwrap();
            // One byte at a time, so that nothing is taken from the pipe that is not asked for.
            let mut out = BufReader::with_capacity(1, child.stdout.take().unwrap());
            let said: Vec<String> = (0..lines).map_while(|_| line(&mut out)).collect();
            child.stdout = Some(out.into_inner());
            let serving = Serving { child, endpoint, said };
            if serving.said.len() == lines {
                return serving;
            }
        }
        panic!("no service in five tries");
    }

    fn signal(&self, signal: &str) {
        send(signal, self.child.id());
    }

    /// How it ended, and what it said on standard error.
    fn ends(mut self) -> (ExitStatus, String) {
        let status = wait(&mut self.child);
        let mut text = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
        (status, text)
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn line(out: &mut impl BufRead) -> Option<String> {
    let mut line = String::new();
    (out.read_line(&mut line).unwrap() > 0).then(|| line.trim().to_owned())
}

fn send(signal: &str, process: u32) {
    assert!(Command::new("sh").args(["-c", &format!("kill -{signal} {process}")]).status().unwrap().success());
}

fn wait(child: &mut Child) -> ExitStatus {
    let begin = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        assert!(begin.elapsed() < LIMIT, "the process does not end");
        std::thread::yield_now();
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

async fn client(endpoint: &str, name: &str) -> Client {
    let options = ClientOptions {
        connect_limit: LIMIT,
        discovery_limit: LIMIT,
        request_timeout: LIMIT,
        twist_timeout: LIMIT,
        ..ClientOptions::named(name).unwrap().at(endpoint).unwrap()
    };
    Client::connect(options).await.unwrap()
}

fn settings() -> TaskSettings {
    let (focal, center) = (64.0, 31.5);
    let optics = Camera { fx: focal, fy: focal, cx: center, cy: center, width: SIZE, height: SIZE, distortion: None };
    TaskSettings { depth: Depth::ConstantM(1.0), lease: Lease::None, ..TaskSettings::new(optics) }
}

fn picture(sequence: u64) -> OutgoingFrame {
    let gray = |at: u32| {
        let (u, v) = (f64::from(at % SIZE) - 30.0 - sequence as f64, f64::from(at / SIZE) - 32.0);
        (220.0 * (-(u * u + v * v) / 150.0).exp()) as u8
    };
    OutgoingFrame::mono8(SIZE, SIZE, (0..SIZE * SIZE).map(gray).collect::<Vec<u8>>()).unwrap().numbered(sequence, 0)
}

#[test]
fn either_signal_ends_it_in_order() {
    for signal in ["TERM", "INT"] {
        let serving = Serving::start(&["--metrics", "127.0.0.1:0"], 2);
        assert!(serving.said[0].contains("is ready on"), "{:?}", serving.said);
        serving.signal(signal);
        assert_eq!(serving.ends().0.code(), Some(0), "{signal}");
    }
}

#[test]
fn a_second_signal_ends_it_at_once_and_the_exit_code_says_so() {
    let ended_by_two = || {
        let serving = Serving::start(&[], 1);
        // Stopped, so that it finds both when it goes on.
        serving.signal("STOP");
        serving.signal("TERM");
        serving.signal("INT");
        serving.signal("CONT");
        serving.ends().0.code()
    };
    // Two that two threads take at the same instant count as one, which is an end in order, and seldom.
    let code = (0..5).map(|_| ended_by_two()).find(|code| *code != Some(0));
    assert_eq!(code, Some(Some(4)));
}

#[test]
fn sixty_four_tasks_a_recording_and_a_client_that_hangs_do_not_hold_up_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("server.toml");
    std::fs::write(&config, "[limits]\ntasks_per_client = 64\n").unwrap();
    let recordings = folder.path().join("recordings");
    let options = ["--config", config.to_str().unwrap(), "--record", recordings.to_str().unwrap()];
    let serving = Serving::start(&options, 1);
    let follower = Command::new(env!("CARGO_BIN_EXE_domvs"))
        .args(["sim", "camera", "--size", "64x64", "--follow", "many", "-e", &serving.endpoint])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let mut follower = follower.unwrap();
    runtime().block_on(async {
        let client = client(&serving.endpoint, "many").await;
        let mut tasks = Vec::new();
        for _ in 0..64 {
            tasks.push(client.create_task(&settings()).await.unwrap());
        }
        for task in &tasks {
            task.set_target(&picture(0)).await.unwrap();
            task.start().await.unwrap();
            task.push(&picture(1)).await.unwrap();
        }
        send("STOP", follower.id());
        serving.signal("TERM");
    });
    let (status, said) = serving.ends();
    follower.kill().unwrap();
    follower.wait().unwrap();
    assert_eq!(status.code(), Some(0), "{said}");
    let files: Vec<_> = std::fs::read_dir(recordings).unwrap().collect();
    assert_eq!(files.len(), 1, "the recording is there");
}

#[test]
fn whoever_does_not_read_its_log_holds_up_neither_twists_nor_the_end() {
    // Everything that there is to say, and nobody reads it: the pipe is full at once.
    let mut serving = Serving::start(&["-vvv"], 1);
    runtime().block_on(async {
        let client = client(&serving.endpoint, "alice").await;
        let task = client.create_task(&settings()).await.unwrap();
        task.set_target(&picture(0)).await.unwrap();
        task.start().await.unwrap();
        for sequence in 1..200 {
            assert!(task.twist(&picture(1 + sequence % 2).numbered(sequence, 0)).await.unwrap().is_servoing());
        }
        serving.signal("TERM");
    });
    assert_eq!(wait(&mut serving.child).code(), Some(0));
}

#[test]
fn its_log_is_json_with_task_and_client_has_no_secret_and_a_flood_is_cut() {
    let serving = Serving::start(&["-v", "--log-format", "json"], 1);
    let (task, secret) = runtime().block_on(async {
        let client = client(&serving.endpoint, "alice").await;
        let task = client.create_task(&settings()).await.unwrap();
        let stranger = client.attach(task.key().clone(), Some(Secret::new([9; 16]))).await.unwrap();
        for _ in 0..100 {
            stranger.stop().await.unwrap_err();
        }
        (task.key().to_string(), task.secret().unwrap().to_hex())
    });
    serving.signal("TERM");
    let (status, log) = serving.ends();
    assert_eq!(status.code(), Some(0), "{log}");
    let lines: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let created = lines.iter().find(|line| line["message"] == "created").unwrap_or_else(|| panic!("{log}"));
    assert_eq!((created["task"].as_str(), created["client"].as_str()), (Some(&*task), Some("alice")));
    let refused: Vec<&Value> = lines.iter().filter(|line| line["code"] == "not_owner").collect();
    assert!(!refused.is_empty() && refused.len() < 100, "{} lines", refused.len());
    assert!(refused.iter().all(|line| line["level"] == "WARN"));
    assert!(!log.contains(&secret) && !log.contains(&"09".repeat(16)));
}

#[test]
fn its_metrics_are_where_it_says() {
    let serving = Serving::start(&["--metrics", "127.0.0.1:0"], 2);
    let address = serving.said[1].strip_prefix("metrics on http://").and_then(|url| url.strip_suffix("/metrics"));
    let mut stream = TcpStream::connect(address.unwrap()).unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: domvs\r\n\r\n").unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    assert!(page.starts_with("HTTP/1.1 200 OK") && page.contains("\ndomvs_build_info{"), "{page}");
}

#[test]
fn it_ends_with_whoever_holds_its_standard_input_if_told_to() {
    let mut serving = Serving::start(&["--while-stdin-is-open"], 1);
    drop(serving.child.stdin.take());
    assert_eq!(serving.ends().0.code(), Some(0));
}
