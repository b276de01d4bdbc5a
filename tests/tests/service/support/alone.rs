//! Tests over TLS, each in a process of its own. Zenoh 1.10.2 reads and writes one TLS stream from two threads at once
//! (<https://github.com/eclipse-zenoh/zenoh/issues/2557>); now and then a process dies of it, and it must be neither the one that runs the other tests
//! nor a verdict on what is tested. docs/security.md says what it means for a lab.

use std::ffi::OsStr;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output};

/// SIGILL, SIGBUS, SIGSEGV: what a process dies of when its memory is not what it thinks.
const MEMORY: [i32; 3] = [4, 7, 11];
/// One in some twenty dies.
const TRIES: usize = 5;

/// Runs an ignored test of this binary by itself, again if its memory was corrupted.
pub fn alone(test: &str, environment: &[(&str, &OsStr)]) -> Output {
    for _ in 0..TRIES {
        let output = Command::new(std::env::current_exe().expect("this binary"))
            .args(["--exact", test, "--ignored", "--nocapture"])
            .envs(environment.iter().copied())
            .output()
            .expect("it runs");
        match output.status.signal() {
            Some(signal) if MEMORY.contains(&signal) => eprintln!("{test}: signal {signal}, zenoh#2557; once more"),
            _ => return output,
        }
    }
    panic!("{test}: ended by a signal {TRIES} times");
}

/// The test `in_its_own_process` of this module holds.
pub fn holds_alone(module: &str) {
    let (_, module) = module.split_once("::").expect("a path in this binary");
    let output = alone(&format!("{module}::in_its_own_process"), &[]);
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}\n{}", said, String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("1 passed"), "{module} was not found: {said}");
}

/// A test over TLS: `NAME::holds` runs `NAME::in_its_own_process` in a process of its own.
macro_rules! over_tls {
    (async fn $name:ident() { $($body:tt)* }) => {
        mod $name {
            use super::*;

            #[test]
            fn holds() {
                crate::support::holds_alone(module_path!());
            }

            #[tokio::test(flavor = "multi_thread")]
            #[ignore = "in a process of its own, by `holds`"]
            async fn in_its_own_process() {
                $($body)*
            }
        }
    };
}
