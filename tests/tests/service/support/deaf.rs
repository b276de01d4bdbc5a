//! A link whose far end hears and is not heard: what a client does that no longer reads and is not dead.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// One TCP connection passed on, until it turns deaf: then nothing from the router is taken any more, and all that the client says
/// still goes out.
pub struct DeafLink {
    pub endpoint: String,
    deaf: Arc<AtomicBool>,
}

impl DeafLink {
    /// A way to `router`, an endpoint like `tcp/127.0.0.1:1`, for one connection.
    pub fn to(router: &str) -> DeafLink {
        let router = router.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("bound"));
        let deaf = Arc::new(AtomicBool::new(false));
        let turned = Arc::clone(&deaf);
        std::thread::spawn(move || {
            let (client, _) = listener.accept().expect("somebody connects");
            let router = TcpStream::connect(router).expect("the router is there");
            let (up, down) = (both(&client, &router), both(&router, &client));
            std::thread::spawn(move || pass_on(up, || false));
            pass_on(down, || turned.load(Ordering::Acquire));
        });
        DeafLink { endpoint, deaf }
    }

    /// From here on nothing is read.
    pub fn turn_deaf(&self) {
        self.deaf.store(true, Ordering::Release);
    }
}

fn both(from: &TcpStream, to: &TcpStream) -> (TcpStream, TcpStream) {
    (from.try_clone().expect("a socket"), to.try_clone().expect("a socket"))
}

fn pass_on((mut from, mut to): (TcpStream, TcpStream), is_deaf: impl Fn() -> bool) {
    let mut buffer = vec![0; 1 << 16];
    // A deaf end keeps its socket: what the router sends fills the buffers of the system.
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        if to.write_all(&buffer[..count]).is_err() {
            break;
        }
        while is_deaf() {
            std::thread::park_timeout(Duration::from_secs(1));
            if to.take_error().is_err() {
                return;
            }
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
