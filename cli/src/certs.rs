//! A lab's identities for [`mod@crate::commands::certs`]: one certificate authority of its own, a certificate, a password and a Zenoh
//! configuration for each member, and the router's configuration, which knows them all. The configurations are those of `deploy/zenoh/tls`,
//! with the lab's names and paths in the place of the example's.
//!
//! Zenoh has no list of revoked certificates, but it wants the password too: deleting a line of `users.txt` locks an identity out.

mod authority;
mod configs;
mod files;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use domvs_proto::keys::Name;

pub use authority::Authority;
pub use configs::Places;
pub use files::{Existing, LabFile, Secrecy};

/// What a member may do; `deploy/zenoh/tls/router.json5` says it in rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Role {
    /// Everybody's meeting point; it guards the keys
    Router,
    /// A worker: serves tasks, reads cameras
    Service,
    /// A tenant: its own tasks
    Client,
    /// A screen: reads statuses and commands, may stop everything
    Viewer,
    /// An arm: reads commands and statuses, may stop everything
    Robot,
    /// A camera: sends its frames
    Camera,
}

impl Role {
    /// As files and markers are called.
    pub fn word(self) -> &'static str {
        match self {
            Role::Router => "router",
            Role::Service => "service",
            Role::Client => "client",
            Role::Viewer => "viewer",
            Role::Robot => "robot",
            Role::Camera => "camera",
        }
    }
}

/// The name of the router's files and certificate; nobody else's.
pub const ROUTER: &str = "router";
/// The router's users, `name:password`.
pub const USERS: &str = "users.txt";
/// The authority's certificate, which everybody has.
pub const CA_CERTIFICATE: &str = "ca.pem";
/// The authority's key, which nobody needs but this command.
pub const CA_KEY: &str = "ca.key.pem";

/// Who takes part, by name: a name with several roles is one identity with the rights of all of them.
pub type Members = BTreeMap<Name, BTreeSet<Role>>;

/// What shall be made.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Where the files are written.
    pub folder: PathBuf,
    /// Where they will lie on the machines that use them.
    pub at: PathBuf,
    /// Names and addresses of the router, in its certificate; the first is where everybody connects.
    pub hosts: Vec<String>,
    /// How long certificates are valid, days.
    pub days: u32,
    /// Whether files that exist are replaced.
    pub existing: Existing,
    /// Everybody but the router.
    pub members: Members,
}

/// Makes a lab from nothing: authority, router, members.
///
/// # Errors
/// Fails when a name is taken or reserved, when a file exists and must not be replaced, or cannot be written.
pub fn make(plan: &Plan) -> anyhow::Result<Vec<LabFile>> {
    check(&plan.members)?;
    let places = Places::new(plan)?;
    let authority = Authority::new()?;
    let mut made = vec![
        LabFile::new(CA_CERTIFICATE, Secrecy::Public, authority.certificate()?),
        LabFile::new(CA_KEY, Secrecy::Secret, authority.key()),
    ];
    made.extend(router(plan, &authority)?);
    made.push(LabFile::new("router.json5", Secrecy::Public, configs::router(&places, &plan.members)?));
    let mut users = String::new();
    for (name, roles) in &plan.members {
        let password = password();
        made.extend(member(plan, &authority, &places, name, roles, &password)?);
        users.push_str(&format!("{name}:{password}\n"));
    }
    made.push(LabFile::new(USERS, Secrecy::Secret, users));
    files::write(&plan.folder, &made, plan.existing)?;
    Ok(made)
}

/// Gives new members, or old ones anew, an identity of a lab that exists. The router must be restarted to know them.
///
/// # Errors
/// As [`make`]; and when the folder has no authority, or its files are not as this command wrote them.
pub fn add(plan: &Plan) -> anyhow::Result<Vec<LabFile>> {
    check(&plan.members)?;
    let places = Places::new(plan)?;
    let read = |name: &str| {
        let path = plan.folder.join(name);
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let authority = Authority::read(&read(CA_CERTIFICATE)?, &read(CA_KEY)?)?;
    let (mut users, mut router) = (read(USERS)?, read("router.json5")?);
    let mut made = vec![];
    for (name, roles) in &plan.members {
        let password = password();
        made.extend(member(plan, &authority, &places, name, roles, &password)?);
        users = with_user(&users, name, &password);
        for role in roles {
            router = configs::with_member(&router, *role, name)?;
        }
    }
    files::check_absent(&plan.folder, &made, plan.existing)?;
    // Theirs from before, with something in them that was not there.
    made.push(LabFile::new("router.json5", Secrecy::Public, router));
    made.push(LabFile::new(USERS, Secrecy::Secret, users));
    files::write(&plan.folder, &made, Existing::Replace)?;
    Ok(made)
}

/// Gives the router a new certificate and key of the lab's authority, before the old one runs out or for another address.
///
/// # Errors
/// As [`add`].
pub fn renew_router(plan: &Plan) -> anyhow::Result<Vec<LabFile>> {
    let read = |name: &str| {
        let path = plan.folder.join(name);
        std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
    };
    let authority = Authority::read(&read(CA_CERTIFICATE)?, &read(CA_KEY)?)?;
    let made = router(plan, &authority)?.to_vec();
    files::write(&plan.folder, &made, plan.existing)?;
    Ok(made)
}

fn check(members: &Members) -> anyhow::Result<()> {
    for (name, roles) in members {
        let reserved = [ROUTER, "ca", "users"].contains(&name.as_str()) || roles.contains(&Role::Router);
        ensure!(!reserved, "'{name}' is the name of files of the lab itself, choose another one");
        if roles.contains(&Role::Service) && roles.len() > 1 {
            bail!(
                "'{name}' would be a service and {} more; a service may do everything, so it shares its name with nobody",
                roles.len() - 1
            );
        }
    }
    Ok(())
}

fn router(plan: &Plan, authority: &Authority) -> anyhow::Result<[LabFile; 2]> {
    let identity = authority.router(&plan.hosts, plan.days)?;
    Ok([
        LabFile::new("router.pem", Secrecy::Public, identity.certificate),
        LabFile::new("router.key.pem", Secrecy::Secret, identity.key),
    ])
}

fn member(
    plan: &Plan,
    authority: &Authority,
    places: &Places,
    name: &Name,
    roles: &BTreeSet<Role>,
    password: &str,
) -> anyhow::Result<[LabFile; 3]> {
    let identity = authority.member(name, plan.days)?;
    let role = roles.first().context("a member has a role")?;
    let config = configs::member(places, *role, name, password)?;
    Ok([
        LabFile::new(format!("{name}.pem"), Secrecy::Public, identity.certificate),
        LabFile::new(format!("{name}.key.pem"), Secrecy::Secret, identity.key),
        LabFile::new(format!("{name}.json5"), Secrecy::Secret, config),
    ])
}

/// 128 bits by chance, in hexadecimal.
fn password() -> String {
    rand::random::<[u8; 16]>().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The users with this one's new password.
fn with_user(users: &str, name: &Name, password: &str) -> String {
    let others = users.lines().filter(|line| line.split(':').next().is_none_or(|user| user.trim() != name.as_str()));
    others.map(str::to_owned).chain([format!("{name}:{password}")]).map(|line| line + "\n").collect()
}

/// Where something of the lab lies, for a sentence.
pub fn shown(folder: &Path, file: &LabFile) -> String {
    folder.join(&file.name).display().to_string()
}

#[cfg(test)]
mod tests;
