//! The Zenoh configurations of `deploy/zenoh/tls` with a lab's names, paths and passwords. They are changed as text, so what a lab gets
//! is commented like the originals, and an operator's own changes outlive a member who is added later.
//!
//! What belongs to one member stands between `// each ROLE: NAME` and `// end of each ROLE`, and is repeated for every member of that role.

use std::path::Path;

use anyhow::{Context, ensure};
use domvs_proto::keys::Name;

use super::{Members, Plan, Role};

const ROUTER: &str = include_str!("../../../deploy/zenoh/tls/router.json5");
const SERVICE: &str = include_str!("../../../deploy/zenoh/tls/service.json5");
const CLIENT: &str = include_str!("../../../deploy/zenoh/tls/client.json5");
const VIEWER: &str = include_str!("../../../deploy/zenoh/tls/viewer.json5");
const ROBOT: &str = include_str!("../../../deploy/zenoh/tls/robot.json5");
const CAMERA: &str = include_str!("../../../deploy/zenoh/tls/camera.json5");

/// What stands in the originals.
const FOLDER: &str = "/etc/domvs/";
const ENDPOINT: &str = "tls/127.0.0.1:7447";
const PASSWORD: &str = "change-me";
const PORT: u16 = 7447;

/// Where files and router are.
pub struct Places {
    /// With a slash at its end, and escaped for JSON.
    folder: String,
    endpoint: String,
}

impl Places {
    /// As the plan has them.
    ///
    /// # Errors
    /// Fails when the folder's name is not UTF-8, or there is no host.
    pub fn new(plan: &Plan) -> anyhow::Result<Places> {
        let host = plan.hosts.first().context("expected at least one --router HOST")?;
        let host = if host.contains(':') { format!("[{host}]") } else { host.clone() };
        Ok(Places { folder: escaped(&plan.at)?, endpoint: format!("tls/{host}:{PORT}") })
    }
}

fn escaped(folder: &Path) -> anyhow::Result<String> {
    let folder = folder.to_str().with_context(|| format!("{} is not UTF-8", folder.display()))?;
    let quoted = serde_json::to_string(&format!("{}/", folder.trim_end_matches('/')))?;
    Ok(quoted.trim_matches('"').to_owned())
}

/// The original of a role, and the name of the member in it.
fn original(role: Role) -> (&'static str, &'static str) {
    match role {
        Role::Router => (ROUTER, "router"),
        Role::Service => (SERVICE, "service"),
        Role::Client => (CLIENT, "alice"),
        Role::Viewer => (VIEWER, "viewer"),
        Role::Robot => (ROBOT, "robot"),
        Role::Camera => (CAMERA, "front"),
    }
}

/// A member's configuration.
pub(super) fn member(places: &Places, role: Role, name: &Name, password: &str) -> anyhow::Result<String> {
    let (text, example) = original(role);
    let text = text.replace(&format!("\"{PASSWORD}\""), &format!("\"{password}\""));
    let text = text.replace(&format!("\"{ENDPOINT}\""), &format!("\"{}\"", places.endpoint));
    let text = text.replace(&format!("user: \"{example}\""), &format!("user: \"{name}\""));
    let text = text.replace(&format!("{FOLDER}{example}."), &format!("{FOLDER}{name}."));
    Ok(text.replace(&format!("\"{FOLDER}"), &format!("\"{}", places.folder)))
}

/// The router's configuration for these members.
pub(super) fn router(places: &Places, members: &Members) -> anyhow::Result<String> {
    let mut text = without_members(ROUTER);
    for role in [Role::Service, Role::Client, Role::Viewer, Role::Robot, Role::Camera] {
        for (name, _) in members.iter().filter(|(_, roles)| roles.contains(&role)) {
            text = with_member(&text, role, name)?;
        }
    }
    Ok(text.replace(&format!("\"{FOLDER}"), &format!("\"{}", places.folder)))
}

fn begins(line: &str) -> bool {
    line.trim_start().starts_with("// each ")
}

fn ends(line: &str) -> bool {
    line.trim_start().starts_with("// end of each ")
}

/// The markers stay, what is between them goes.
fn without_members(text: &str) -> String {
    let mut inside = false;
    let kept = text.lines().filter(|line| {
        inside = (inside || begins(line)) && !ends(line);
        !inside || begins(line)
    });
    kept.map(|line| format!("{line}\n")).collect()
}

/// What stands in the original for each member of a role, in its order.
fn blocks(role: Role) -> Vec<String> {
    let end = format!("// end of each {}", role.word());
    let begin = format!("// each {}: ", role.word());
    let mut blocks: Vec<String> = vec![];
    let mut inside = false;
    for line in ROUTER.lines() {
        if line.trim() == end {
            inside = false;
        } else if line.trim_start().starts_with(&begin) {
            inside = true;
            blocks.push(String::new());
        } else if let (true, Some(block)) = (inside, blocks.last_mut()) {
            block.push_str(line);
            block.push('\n');
        }
    }
    blocks
}

/// The router's configuration `text` with one more member in a role; unchanged if it is there already.
pub(super) fn with_member(text: &str, role: Role, name: &Name) -> anyhow::Result<String> {
    let end = format!("// end of each {}", role.word());
    let (_, example) = original(role);
    let blocks: Vec<String> = blocks(role).iter().map(|block| renamed(block, example, name)).collect();
    let places = text.lines().filter(|line| line.trim() == end).count();
    ensure!(
        places == blocks.len(),
        "expected {} lines '{end}' in router.json5, found {places}; add {name} by hand",
        blocks.len()
    );
    let mut blocks = blocks.iter();
    let mut whole = String::new();
    for line in text.lines() {
        if line.trim() == end {
            let block = blocks.next().expect("as many as counted above");
            if !text.contains(block.as_str()) {
                whole.push_str(block);
            }
        }
        whole.push_str(line);
        whole.push('\n');
    }
    Ok(whole)
}

/// A name stands alone in a string, at its end, or is a chunk of a key.
fn renamed(block: &str, example: &str, name: &Name) -> String {
    [("\"", "\""), (" ", "\""), ("/", "/"), ("/", "\"")].iter().fold(block.to_owned(), |text, (before, after)| {
        text.replace(&format!("{before}{example}{after}"), &format!("{before}{name}{after}"))
    })
}
