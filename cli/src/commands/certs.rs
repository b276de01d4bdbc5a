//! `domvs certs`: a lab's certificates, passwords and Zenoh configurations.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use clap::builder::RangedU64ValueParser;
use comfy_table::{Table, presets};
use domvs_proto::keys::Name;

use crate::certs::{self, CA_KEY, Existing, LabFile, Members, Plan, ROUTER, Role, Secrecy};
use crate::exit;
use crate::paint::print_line;

/// A century; nobody means more.
const MOST_DAYS: u64 = 36_500;

/// Make a lab's certificates, passwords and Zenoh configurations
///
/// Writes a certificate authority of your own, and for the router, the service and every camera, robot, viewer and client
/// named a certificate, a key, a password and a Zenoh configuration (JSON5) that uses them. A name given to several roles is
/// one identity with the rights of all of them. docs/security.md says what each may do, and how to renew and revoke.
#[derive(Args, Clone, Debug)]
pub struct CertsArgs {
    /// The folder to write to
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,

    /// A host name or address of the router, again for more; everybody connects to the first [default: 127.0.0.1, localhost]
    #[arg(long = "router", value_name = "HOST")]
    hosts: Vec<String>,

    /// A client: a tenant who sees only its own tasks. Again for more, as the next four
    #[arg(long = "client", value_name = "NAME", value_parser = name, conflicts_with = "add")]
    clients: Vec<Name>,

    /// A worker
    #[arg(long = "service", value_name = "NAME", value_parser = name, default_value = "service", conflicts_with = "add")]
    services: Vec<Name>,

    /// A camera, called as in domvs/camera/NAME/frame
    #[arg(long = "camera", value_name = "NAME", value_parser = name, default_value = "camera", conflicts_with = "add")]
    cameras: Vec<Name>,

    /// An arm's controller
    #[arg(long = "robot", value_name = "NAME", value_parser = name, default_value = "robot", conflicts_with = "add")]
    robots: Vec<Name>,

    /// A screen that shows what goes on
    #[arg(long = "viewer", value_name = "NAME", value_parser = name, default_value = "viewer", conflicts_with = "add")]
    viewers: Vec<Name>,

    /// Add somebody to the lab that FOLDER has, with the same authority; with --force: give a new certificate and password
    #[arg(long, value_name = "NAME")]
    add: Vec<String>,

    /// What those added are; "--add router --role router" renews the router's own certificate
    #[arg(long, value_enum, default_value = "client", requires = "add")]
    role: Role,

    /// Days until the certificates run out; the authority has ten years
    #[arg(long, value_name = "N", default_value_t = 365, value_parser = RangedU64ValueParser::<u32>::new().range(1..=MOST_DAYS))]
    days: u32,

    /// The folder in which the files will lie on their machines, such as /etc/domvs [default: FOLDER, for this machine]
    #[arg(long, value_name = "FOLDER")]
    at: Option<PathBuf>,

    /// Replace what is there. Without --add: a new authority, which no certificate made before is good for
    #[arg(long)]
    force: bool,
}

fn name(text: &str) -> Result<Name, String> {
    Name::try_from(text).map_err(|error| error.to_string())
}

/// Writes the files and says where each belongs.
///
/// # Errors
/// Fails when a name or host is none, or a file is there already or cannot be written.
pub fn run(args: &CertsArgs) -> anyhow::Result<ExitCode> {
    let plan = plan(args)?;
    let made = match (args.add.is_empty(), args.role) {
        (true, _) => certs::make(&plan)?,
        (false, Role::Router) => certs::renew_router(&plan)?,
        (false, _) => certs::add(&plan)?,
    };
    print_line(&table(&plan, &made).to_string())?;
    print_line(&next(args, &plan))?;
    Ok(exit::done())
}

fn plan(args: &CertsArgs) -> anyhow::Result<Plan> {
    let hosts = match args.hosts.is_empty() {
        true => ["127.0.0.1", "localhost"].map(str::to_owned).to_vec(),
        false => args.hosts.clone(),
    };
    let folder = std::path::absolute(&args.folder).with_context(|| args.folder.display().to_string())?;
    let existing = if args.force { Existing::Replace } else { Existing::Refuse };
    let at = args.at.clone().unwrap_or_else(|| folder.clone());
    Ok(Plan { folder, at, hosts, days: args.days, existing, members: members(args)? })
}

fn members(args: &CertsArgs) -> anyhow::Result<Members> {
    let mut members = Members::new();
    if !args.add.is_empty() {
        if args.role == Role::Router {
            anyhow::ensure!(
                args.add.iter().all(|name| name == ROUTER),
                "the router is called router, got {}",
                args.add.join(", ")
            );
            return Ok(members);
        }
        for text in &args.add {
            let name = Name::try_from(text.as_str()).with_context(|| format!("--add {text}"))?;
            members.entry(name).or_default().insert(args.role);
        }
        return Ok(members);
    }
    let named = [
        (Role::Service, &args.services),
        (Role::Client, &args.clients),
        (Role::Viewer, &args.viewers),
        (Role::Robot, &args.robots),
        (Role::Camera, &args.cameras),
    ];
    for (role, names) in named {
        for name in names {
            members.entry(name.clone()).or_default().insert(role);
        }
    }
    Ok(members)
}

fn table(plan: &Plan, made: &[LabFile]) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::UTF8_BORDERS_ONLY).set_header(["file", "mode", "belongs to"]);
    for file in made {
        let mode = format!("{:04o}", file.secrecy.mode());
        table.add_row([certs::shown(&plan.folder, file), mode, belongs(&file.name, file.secrecy)]);
    }
    table
}

fn belongs(name: &str, secrecy: Secrecy) -> String {
    match name.split('.').next().unwrap_or(name) {
        "ca" if secrecy == Secrecy::Public => "every machine".into(),
        "ca" => "nobody: keep it off the network, it makes new members".into(),
        "users" | ROUTER => "the router's machine".into(),
        member => format!("{member}'s machine"),
    }
}

fn next(args: &CertsArgs, plan: &Plan) -> String {
    let at = |name: &str| shell_word(&plan.at.join(name));
    let folder = plan.folder.display();
    let copy = match &args.at {
        Some(at) => format!(
            "Copy each member's three files and ca.pem to {} on its machine, the router's four likewise.",
            at.display()
        ),
        None => format!(
            "The files name the folder {folder}; for other machines make them with --at /etc/domvs and copy them there."
        ),
    };
    if !args.add.is_empty() {
        return format!("{copy}\nThe router must be restarted to know what has changed.");
    }
    let service = args.services.first().map_or("service", Name::as_str);
    let mut lines = vec![
        copy,
        format!(
            "Move {} to a safe place; `domvs certs {folder} --add NAME` needs it back.",
            plan.folder.join(CA_KEY).display()
        ),
        format!("  zenohd --config {}", at("router.json5")),
        format!("  domvs serve --zenoh-config {}", at(&format!("{service}.json5"))),
    ];
    if let Some(client) = args.clients.first() {
        lines.push(format!(
            "  domvs task run --client {client} --camera NAME --zenoh-config {}",
            at(&format!("{client}.json5"))
        ));
    }
    lines.push("Refused access is silence: docs/security.md says what each may do.".into());
    lines.join("\n")
}

fn shell_word(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = text.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c));
    if plain { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}
