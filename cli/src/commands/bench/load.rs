//! `domvs bench load`: many tasks at once.

use std::process::ExitCode;

use anyhow::ensure;
use clap::Args;

use super::{at_least_one, finish};
use crate::bench::cases::{CaseOptions, DepthKind};
use crate::bench::load::{Demand, LoadRow, measure};
use crate::bench::place::{Place, PlaceOptions};
use crate::bench::rows::{OutOptions, Row, growth_panels};
use crate::bench::watch::Watch;
use crate::options::positive;
use crate::paint::Paint;
use crate::report::plots::{Panel, Scale, Series};

/// Many tasks at once: what is answered, how late, how evenly, at which cost
///
/// Each task has a client with a session of its own, which asks for a twist whenever a frame is due. The same clients send the same
/// frames to an echo, in turns with the worker. The clients share the machine with the worker.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct LoadArgs {
    #[command(flatten)]
    cases: CaseOptions,

    /// How many tasks
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "20", value_parser = at_least_one)]
    tasks: Vec<usize>,

    /// Frames a second from each task; 0: the next frame when one was answered
    #[arg(long, value_name = "HZ", default_value = "30", value_parser = rate, conflicts_with = "overload")]
    rate: f64,

    /// With --rate 0: frames of each task that wait for their answers at any time. From 2 on the worker always has the next one, as
    /// from a camera that waits for nobody
    #[arg(long, value_name = "N", default_value = "1", value_parser = at_least_one)]
    ahead: usize,

    /// X times as many frames as the worker answered when it was asked as fast as it answers
    #[arg(long, value_name = "X", value_parser = positive)]
    overload: Option<f64>,

    /// Seconds of load on the worker; the echo gets as many
    #[arg(long, value_name = "S", default_value = "10", value_parser = positive)]
    seconds: f64,

    #[command(flatten)]
    place: PlaceOptions,

    #[command(flatten)]
    out: OutOptions,
}

const AFTER_HELP: &str = "\
Without --size, --order and --depth: 640x480, order 8, constant depth. A worker that is started here takes 64 tasks, or what limits.tasks of \
its --config says.

The JSON objects have case (load), size, order, method, depth, tasks, rate_hz, ahead, seconds, sent, servoing (answers with a twist), \
overloaded, deadline_missed, other_status, unanswered, unsent, median_ms and p99_ms (of the answers with a twist, from when the frame was \
due), frames_per_s (those answers), fairness (twists of the slowest task over those of the fastest), echo_median_ms, echo_p99_ms, \
p99_over_echo, echo_beside_p99_ms (one camera that asks the echo while the worker has its load), p99_over_echo_beside, worker_cores (that it kept busy), worker_rss_mb (before, started, during, closed) and per_task.

Exit codes: 0 done, 1 an error, 2 the command line was not understood, 130 interrupted.";

fn rate(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(rate) if (0.0..=1e4).contains(&rate) => Ok(rate),
        _ => Err(format!("expected frames a second from 0 to 10000, got '{text}'")),
    }
}

/// Measures.
pub(super) fn run(args: &LoadArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let cases = args.cases.clone().or(&[8], &[DepthKind::Constant]).cases()?;
    ensure!(args.ahead == 1 || args.rate == 0.0, "--ahead needs --rate 0: at a rate, frames go out when they are due");
    let demand = match (args.overload, args.rate) {
        (Some(times), _) => Demand::TimesCapacity(times),
        (None, 0.0) => Demand::AsAnswered { ahead: args.ahead },
        (None, rate_hz) => Demand::Hz(rate_hz),
    };
    let watch = Watch::start(cases.len() * args.tasks.len(), paint_errors)?;
    let measure = |place| measure(&place, &crate::runtime()?, &cases, &args.tasks, demand, args.seconds, &watch);
    let rows = Place::open(&args.place).and_then(measure);
    finish(rows, &watch, &args.out, "load", panels, paint)
}

/// Twists a second, and times, against the number of tasks; or what else was varied.
fn panels(rows: &[LoadRow]) -> Vec<Panel> {
    let only_tasks_vary = rows.len() > 1 && rows.windows(2).all(|pair| pair[0].tasks != pair[1].tasks);
    if !only_tasks_vary {
        return growth_panels(rows);
    }
    let twists = line("", rows, |row| row.common.frames_per_s);
    let (worker, echo) = (line("worker", rows, |row| row.common.p99_ms), line("echo", rows, |row| row.echo_p99_ms));
    let panel = |y_label: &str, series: Vec<Series>| {
        let common = rows[0].common();
        let title = format!("{} {}, order {}", common.method, common.size, common.order);
        Panel { title, x_label: "tasks".to_owned(), y_label: y_label.to_owned(), scale: Scale::Linear, series }
    };
    vec![panel("twists a second", vec![twists]), panel("99th percentile, ms", vec![worker, echo])]
}

fn line(label: &str, rows: &[LoadRow], value: fn(&LoadRow) -> f64) -> Series {
    let mut points: Vec<(f64, f64)> = rows.iter().map(|row| (row.tasks as f64, value(row))).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    Series { label: label.to_owned(), points }
}
