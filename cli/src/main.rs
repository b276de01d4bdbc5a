//! The command `domvs`: reads the command line and hands over to one file per subcommand (`commands`).

use std::process::ExitCode;

use clap::{ArgAction, CommandFactory, FromArgMatches, Parser, Subcommand};
use domvs::commands::{bench, certs, demo, experiment, serve, sim, stop, task, twist};
use domvs::exit;
use domvs::explain::explained;
use domvs::log::{self, LogFormat};
use domvs::paint::{ColorWhen, Paint};

/// Servo a camera to where a desired image was taken, by direct visual servoing on orthogonal moments.
#[derive(Parser)]
#[command(name = "domvs", version, about, after_help = exit::HELP, max_term_width = 110)]
struct Cli {
    /// When to use colours
    #[arg(long, global = true, help_heading = "General options", value_enum, value_name = "WHEN", default_value_t)]
    color: ColorWhen,

    /// Say more on standard error: -v what an operator wants to know, -vv what a developer does, -vvv everything
    ///
    /// DOMVS_LOG, or else RUST_LOG, overrides it with a filter such as "warn,domvs_server=debug".
    #[arg(short, long, global = true, help_heading = "General options", action = ArgAction::Count)]
    verbose: u8,

    /// How lines of the log are written on standard error
    #[arg(long, global = true, help_heading = "General options", value_enum, value_name = "FORM", default_value_t)]
    log_format: LogFormat,

    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Bench(bench::BenchArgs),
    Certs(certs::CertsArgs),
    Demo(demo::DemoArgs),
    Experiment(experiment::ExperimentArgs),
    Serve(serve::ServeArgs),
    Sim(sim::SimArgs),
    Task(task::TaskArgs),
    Stop(stop::StopArgs),
    Twist(twist::TwistArgs),
}

fn main() -> ExitCode {
    let command = Cli::command().color(ColorWhen::among(std::env::args_os()).for_clap());
    let cli = Cli::from_arg_matches(&command.get_matches()).unwrap_or_else(|error| error.exit());
    let paint = Paint::for_stdout(cli.color);
    let paint_errors = Paint::for_stderr(cli.color);
    // Kept to the end: it writes the last lines.
    let _log = match log::start(cli.verbose, cli.log_format, paint_errors.colored) {
        Ok(log) => log,
        Err(error) => {
            eprintln!("cannot start the log: {error}");
            return exit::failed();
        }
    };

    let result = match cli.command {
        Command::Bench(args) => bench::run(&args, paint, paint_errors),
        Command::Certs(args) => certs::run(&args),
        Command::Demo(args) => demo::run(&args, paint, paint_errors),
        Command::Experiment(args) => experiment::run(&args, paint, paint_errors),
        Command::Serve(args) => serve::run(&args, paint),
        Command::Sim(args) => sim::run(&args, paint, paint_errors),
        Command::Task(args) => task::run(&args, paint, paint_errors),
        Command::Stop(args) => stop::run(&args),
        Command::Twist(args) => twist::run(&args, paint),
    };
    result.unwrap_or_else(|error| {
        eprintln!("{} {}", paint_errors.bad("error:"), explained(&error));
        exit::failed()
    })
}
