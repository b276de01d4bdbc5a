//! The log: which lines, in which form, and that nobody waits for whoever reads it. Lines go through a bounded queue to a thread that
//! writes them to standard error; a reader that stands still costs lines, which are counted, and never a twist.
//!
//! Zenoh writes its whole configuration at the level debug when a session opens, and the password is in it. Those lines are never
//! written, whatever was asked for.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use clap::ValueEnum;
use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata, Subscriber};
use tracing_subscriber::filter::{FilterExt, filter_fn};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, fmt, registry};

/// Which lines are said: goes before `RUST_LOG`.
pub const VARIABLE: &str = "DOMVS_LOG";
/// Where Zenoh writes its configuration, at a level beyond info.
const CONFIGURATION: &str = "zenoh::api::session";
/// Lines that may wait for the reader.
const WAITING: usize = 1024;
/// How long the end of the program waits for them.
const LAST_LINES: Duration = Duration::from_millis(200);

/// How a line of the log is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line: timestamp, level, target, and the fields beside each other
    Json,
}

/// Writes what waits when it is dropped, for a moment.
pub struct Log {
    lines: SyncSender<Message>,
}

enum Message {
    Line(Vec<u8>),
    /// Answered when everything before it is written.
    Flush(SyncSender<()>),
}

/// Starts the log. `verbose` counts `-v`; the environment overrides it.
///
/// # Errors
/// Fails when the system gives no thread.
pub fn start(verbose: u8, format: LogFormat, colored: bool) -> io::Result<Log> {
    let (lines, waiting) = sync_channel(WAITING);
    let left_out = Arc::new(AtomicU64::new(0));
    let writer = Writer { lines: lines.clone(), left_out: Arc::clone(&left_out) };
    std::thread::Builder::new().name("log".into()).spawn(move || write_lines(&waiting, &left_out, format))?;
    subscriber(asked(verbose), format, writer, colored).init();
    Ok(Log { lines })
}

/// What passes: the variable, or else `RUST_LOG`, or else the level of this many `-v`.
fn asked(verbose: u8) -> EnvFilter {
    let asked = EnvFilter::try_from_env(VARIABLE).or_else(|_| EnvFilter::try_from_default_env());
    asked.unwrap_or_else(|_| EnvFilter::new(directives(verbose)))
}

/// Whoever gets the lines that were asked for, but for Zenoh's configuration.
pub fn subscriber<W>(asked: EnvFilter, format: LogFormat, writer: W, colored: bool) -> impl Subscriber + Send + Sync
where
    W: for<'a> MakeWriter<'a> + Send + Sync + 'static,
{
    // A filter of its own: in the other one, a longer directive would go before it, and it before a stricter one.
    let harmless = filter_fn(is_harmless).with_max_level_hint(LevelFilter::TRACE);
    let log = fmt::layer().with_writer(writer);
    let log = match format {
        LogFormat::Text => log.with_ansi(colored).boxed(),
        LogFormat::Json => log.json().flatten_event(true).boxed(),
    };
    registry().with(log.with_filter(asked.and(harmless)))
}

/// Whether a line cannot be Zenoh's configuration.
fn is_harmless(line: &Metadata<'_>) -> bool {
    !line.target().starts_with(CONFIGURATION) || *line.level() <= Level::INFO
}

fn directives(verbose: u8) -> &'static str {
    match verbose {
        0 => "warn,zenoh=error",
        1 => "warn,zenoh=error,domvs=info",
        2 => "info,domvs=debug",
        _ => "trace",
    }
}

fn write_lines(waiting: &Receiver<Message>, left_out: &AtomicU64, format: LogFormat) {
    while let Ok(message) = waiting.recv() {
        let written = match message {
            Message::Line(line) => io::stderr().write_all(&line),
            // Nobody may wait any more.
            Message::Flush(done) => done.try_send(()).map_err(io::Error::other),
        };
        let missing = left_out.swap(0, Ordering::Relaxed);
        if missing > 0 && written.is_ok() {
            let _ = io::stderr().write_all(missing_line(missing, format).as_bytes());
        }
    }
}

fn missing_line(missing: u64, format: LogFormat) -> String {
    match format {
        LogFormat::Text => format!("WARN the reader of this log was too slow: {missing} lines are missing here\n"),
        LogFormat::Json => {
            format!(
                "{{\"level\":\"WARN\",\"message\":\"the reader of this log was too slow\",\"missing\":{missing}}}\n"
            )
        }
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        let (done, written) = sync_channel(1);
        if self.lines.try_send(Message::Flush(done)).is_ok() {
            // Too late is as good as never: whoever reads does not.
            let _ = written.recv_timeout(LAST_LINES);
        }
    }
}

#[derive(Clone)]
struct Writer {
    lines: SyncSender<Message>,
    left_out: Arc<AtomicU64>,
}

impl<'a> MakeWriter<'a> for Writer {
    type Writer = Writer;

    fn make_writer(&'a self) -> Writer {
        self.clone()
    }
}

impl Write for Writer {
    /// A whole line each time: so the formatter calls it.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) =
            self.lines.try_send(Message::Line(line.to_vec()))
        {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is written of one line of Zenoh's session and one of its transport, under these directives.
    fn written(directives: &str, session: fn(), transport: fn()) -> [bool; 2] {
        [session, transport].map(|say| {
            let (lines, waiting) = sync_channel(8);
            let writer = Writer { lines, left_out: Arc::default() };
            let log = subscriber(EnvFilter::new(directives), LogFormat::Json, writer, false);
            tracing::subscriber::with_default(log, say);
            waiting.try_recv().is_ok()
        })
    }

    #[test]
    fn no_directive_lets_zenohs_configuration_out_and_none_lets_out_more_than_was_asked_for() {
        let debug = |directives| {
            let session = || tracing::debug!(target: "zenoh::api::session", "password");
            written(directives, session, || tracing::debug!(target: "zenoh::transport", "a link"))
        };
        for directives in ["trace", "debug", "info,zenoh=trace", "warn,zenoh=debug,zenoh::api::session=trace"] {
            assert_eq!(debug(directives), [false, true], "{directives}");
        }
        let info = |directives| {
            let session = || tracing::info!(target: "zenoh::api::session", "closed");
            written(directives, session, || tracing::info!(target: "zenoh::transport", "a link"))
        };
        for verbose in [0, 1] {
            assert_eq!(info(directives(verbose)), [false, false], "{verbose}");
        }
        assert_eq!(info(directives(2)), [true, true]);
    }

    #[test]
    fn a_line_that_finds_no_room_is_counted_and_nobody_waits() {
        let (lines, waiting) = sync_channel(1);
        let mut writer = Writer { lines, left_out: Arc::default() };
        for line in ["one\n", "two\n", "three\n"] {
            assert_eq!(writer.write(line.as_bytes()).ok(), Some(line.len()));
        }
        assert_eq!(writer.left_out.load(Ordering::Relaxed), 2);
        assert!(matches!(waiting.recv(), Ok(Message::Line(line)) if line == b"one\n"));
    }

    #[test]
    fn missing_lines_are_told_in_the_form_of_the_others() {
        assert!(missing_line(3, LogFormat::Text).contains(": 3 lines"));
        assert!(missing_line(3, LogFormat::Json).ends_with("\"missing\":3}\n"));
    }
}
