//! `domvs experiment landscape`: the loss around the desired pose, drawn.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use serde_json::{Value, json};

use crate::exit;
use crate::experiment::landscape::{Grid, Landscape, landscape};
use crate::experiment::page::Page;
use crate::experiment::plan::{Overrides, RunPlan};
use crate::experiment::spec::{Entry, Experiment};
use crate::experiment::world::Worlds;
use crate::experiment::{named, pool, progress};
use crate::options::{SizeOption, positive};
use crate::paint::{Paint, print_line};
use crate::report::number;
use crate::report::plots::{Colors, Heat, Plot, heats, write_plots};

/// Draw the loss over shifts of the camera along x and y
///
/// e·e of each method, with the camera shifted from the desired pose and not turned. Without --method and --order: the paper's
/// TM, KM and HM at l = 4, DVS, and HM at l = 3, 6, 10, 20, 30.
#[derive(Args, Clone, Debug)]
#[command(after_help = AFTER_HELP)]
pub struct LandscapeArgs {
    /// A name of `domvs experiment list` or a TOML file, whose camera, scene and target are used
    #[arg(value_name = "NAME|FILE", default_value = "1")]
    experiment: String,

    /// These methods, each at every --order
    #[arg(long = "method", value_name = "NAME", value_delimiter = ',')]
    methods: Vec<String>,

    /// These orders
    #[arg(long = "order", value_name = "L", value_delimiter = ',')]
    orders: Vec<u16>,

    /// The largest shift to each side, m
    #[arg(long, value_name = "M", default_value_t = 0.5, value_parser = positive)]
    reach: f64,

    /// Shifts along each axis; an odd number
    #[arg(long, value_name = "N", default_value_t = 41, value_parser = odd)]
    steps: u16,

    /// Size of the images, pixels
    #[arg(long, value_name = "WxH")]
    size: Option<SizeOption>,

    /// A folder for the plots
    #[arg(long, value_name = "FOLDER", default_value = "runs/experiments/landscape")]
    out: PathBuf,

    /// Print JSON: one object a line for every landscape
    #[arg(long)]
    json: bool,

    /// How many landscapes at once [default: as many as there are cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: Option<u16>,
}

const AFTER_HELP: &str = "\
basin is the share of the shifts from which the steepest way down, from neighbour to neighbour, ends at the desired pose; minima \
counts the other pits; near is the loss at a twentieth of the reach over the largest loss.

The folder holds landscapes.svg (heat maps with contours), landscape.csv (method, x_m, y_m, loss), landscapes.json and index.html.

Exit codes: 0 done, 1 an error, 2 the command line was not understood, 130 interrupted.";

fn odd(text: &str) -> Result<u16, String> {
    match text.parse::<u16>() {
        Ok(steps) if steps % 2 == 1 && (3..=401).contains(&steps) => Ok(steps),
        _ => Err(format!("expected an odd number from 3 to 401, got '{text}'")),
    }
}

/// The paper's methods, as preset and order; none where it has no order.
const OF_THE_PAPER: [(&str, Option<u16>); 9] = [
    ("TM", Some(4)),
    ("KM", Some(4)),
    ("HM", Some(4)),
    ("DVS", None),
    ("HM", Some(3)),
    ("HM", Some(6)),
    ("HM", Some(10)),
    ("HM", Some(20)),
    ("HM", Some(30)),
];

impl LandscapeArgs {
    /// The paper's, into this folder.
    pub(super) fn of_the_paper(out: PathBuf) -> LandscapeArgs {
        LandscapeArgs {
            experiment: "1".to_owned(),
            methods: Vec::new(),
            orders: Vec::new(),
            reach: 0.5,
            steps: 41,
            size: Some(SizeOption { width: 128, height: 128 }),
            out,
            json: false,
            jobs: None,
        }
    }
}

/// Computes, draws and writes.
///
/// # Errors
/// Fails when a name or a file is none, the world is impossible, or the folder cannot be written.
pub fn run(args: &LandscapeArgs, paint: Paint, paint_errors: Paint) -> anyhow::Result<ExitCode> {
    let experiment = named::find(&args.experiment)?;
    let grid = Grid { reach_m: args.reach, steps: usize::from(args.steps) };
    let plans = plans(args, experiment)?;
    let worlds = Worlds::default();
    let bar = progress::bar("maps", plans.len(), 0, paint_errors);
    let mut found: Vec<Option<Landscape>> = vec![None; plans.len()];
    let interrupted = pool::interruption()?;
    let work = |(): &mut (), plan: &RunPlan| landscape(plan, &worlds, grid).with_context(|| plan.cell.method.clone());
    let done = |index: usize, one| {
        bar.inc(1);
        found[index] = Some(one);
        Ok(())
    };
    let jobs = args.jobs.map_or_else(pool::all_cores, usize::from);
    let result = pool::in_parallel(jobs, &plans, &interrupted, || Ok(()), work, done);
    bar.finish_and_clear();
    result?;
    let found: Vec<Landscape> = found.into_iter().flatten().collect();
    write(&args.out, &found, grid)?;
    let text = if args.json {
        found.iter().map(serde_json::to_string).collect::<Result<Vec<_>, _>>()?.join("\n")
    } else {
        let mut table = paint.table(&["method", "basin %", "minima", "near %"]);
        for one in &found {
            let (basin, near) = (number(100.0 * one.basin), number(100.0 * one.near_share));
            table.add_row([paint.bold_cell(&one.method), basin.into(), one.local_minima.into(), near.into()]);
        }
        format!("{table}\nplots: {}", args.out.join("index.html").display())
    };
    print_line(&text).context("cannot write the result")?;
    Ok(if found.len() < plans.len() { exit::interrupted() } else { exit::done() })
}

/// One plan for each method and order, in the experiment's first world.
fn plans(args: &LandscapeArgs, mut experiment: Experiment) -> anyhow::Result<Vec<RunPlan>> {
    let pairs: Vec<(String, Option<u16>)> = match (args.methods.is_empty(), args.orders.is_empty()) {
        (true, true) => OF_THE_PAPER.iter().map(|(method, order)| ((*method).to_owned(), *order)).collect(),
        (no_methods, no_orders) => {
            let methods = if no_methods { vec!["HM".to_owned()] } else { args.methods.clone() };
            let orders: Vec<Option<u16>> =
                if no_orders { vec![None] } else { args.orders.iter().copied().map(Some).collect() };
            methods.iter().flat_map(|method| orders.iter().map(|order| (method.clone(), *order))).collect()
        }
    };
    let entries = pairs.iter().map(|(method, order)| at_order(method, *order)).collect::<anyhow::Result<Vec<_>>>()?;
    experiment.methods = entries;
    experiment.scenes.truncate(1);
    experiment.disturbances.clear();
    let size = args.size.map(|size| [size.width, size.height]);
    experiment.plan(&Overrides { size, displacements: Some(1), ..Overrides::default() })
}

fn at_order(method: &str, order: Option<u16>) -> anyhow::Result<Entry> {
    let mut variant = named::method(method)?;
    if let Some(order) = order {
        variant.name = format!("{} l={order}", variant.name);
        variant.settings.insert("order".to_owned(), Value::from(order));
    }
    variant.is_preset = false;
    Ok(Entry::Inline(Box::new(variant)))
}

fn write(out: &Path, found: &[Landscape], grid: Grid) -> anyhow::Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
    let maps: Vec<Heat> = found.iter().map(|one| heat(one, grid)).collect();
    let plot = Plot { name: "landscapes", svg: heats(&maps, 3)? };
    write_plots(out, std::slice::from_ref(&plot))?;
    let all = json!({ "version": env!("CARGO_PKG_VERSION"), "reach_m": grid.reach_m, "landscapes": found });
    let mut page = Page::new("Loss landscapes");
    page.text(&format!(
        "e·e over shifts of the camera up to {} m along x and y, not turned. Each map has its own scale.",
        grid.reach_m
    ));
    page.wide([&plot]);
    let texts = [("landscapes.json", serde_json::to_string_pretty(&all)? + "\n"), ("index.html", page.finish())];
    for (name, text) in texts {
        let path = out.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    write_csv(&out.join("landscape.csv"), found, grid)
}

fn heat(one: &Landscape, grid: Grid) -> Heat {
    let range = [-grid.reach_m, grid.reach_m];
    Heat {
        title: format!("{} · basin {:.0} %", one.method, 100.0 * one.basin),
        width: grid.steps,
        values: one.loss.clone(),
        ranges: [range; 2],
        labels: ["shift along x (m)".into(), "shift along y (m)".into()],
        colors: Colors::Landscape,
    }
}

fn write_csv(path: &Path, found: &[Landscape], grid: Grid) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut writer = csv::Writer::from_path(path).with_context(failed)?;
    writer.write_record(["method", "x_m", "y_m", "loss"]).with_context(failed)?;
    for one in found {
        for (index, loss) in one.loss.iter().enumerate() {
            let (x, y) = (grid.shift_m(index % grid.steps), grid.shift_m(index / grid.steps));
            let loss = if loss.is_finite() { loss.to_string() } else { String::new() };
            writer.write_record([one.method.clone(), x.to_string(), y.to_string(), loss]).with_context(failed)?;
        }
    }
    writer.flush().with_context(failed)
}
