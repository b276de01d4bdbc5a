//! What a lab gets, on the disk.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::*;

fn plan(folder: &Path, members: &[(&str, &[Role])]) -> Plan {
    let members = members.iter().map(|(name, roles)| (name.parse_name(), roles.iter().copied().collect())).collect();
    let hosts = vec!["127.0.0.1".into(), "robot-lab".into()];
    Plan { folder: folder.to_owned(), at: folder.to_owned(), hosts, days: 30, existing: Existing::Refuse, members }
}

trait ParseName {
    fn parse_name(&self) -> Name;
}

impl ParseName for &str {
    fn parse_name(&self) -> Name {
        Name::try_from(*self).expect("a fine name")
    }
}

const EXAMPLES: [(&str, &[Role]); 5] = [
    ("service", &[Role::Service]),
    ("alice", &[Role::Client]),
    ("viewer", &[Role::Viewer]),
    ("robot", &[Role::Robot]),
    ("front", &[Role::Camera]),
];

fn read(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).expect("it is there")
}

#[test]
fn the_examples_names_and_paths_give_the_shipped_router_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = Plan { at: "/etc/domvs".into(), ..plan(folder.path(), &EXAMPLES) };
    make(&plan).expect("made");
    assert_eq!(read(folder.path(), "router.json5"), include_str!("../../../deploy/zenoh/tls/router.json5"));
}

#[test]
fn keys_passwords_and_what_holds_one_are_their_owners_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = make(&plan(folder.path(), &EXAMPLES)).expect("made");
    // Authority two, router three, users one, members three each.
    assert_eq!(made.len(), 6 + 3 * EXAMPLES.len());
    for file in &made {
        let path = folder.path().join(&file.name);
        let mode = path.metadata().expect("it is there").permissions().mode() & 0o777;
        let text = read(folder.path(), &file.name);
        let secret = text.contains("PRIVATE KEY") || text.contains("password:") || file.name == USERS;
        assert_eq!(mode, if secret { 0o600 } else { 0o644 }, "{}", file.name);
        assert!(!text.contains("change-me") && !text.contains("/etc/domvs/"), "{}", file.name);
        assert!(!format!("{file:?}").contains("PRIVATE"), "{file:?}");
    }
}

#[test]
fn nothing_is_overwritten_unless_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = plan(folder.path(), &EXAMPLES);
    make(&plan).expect("made");
    let before = read(folder.path(), CA_KEY);
    let error = make(&plan).expect_err("refused").to_string();
    assert!(error.contains(CA_KEY) && error.contains("--force"), "{error}");
    assert_eq!(read(folder.path(), CA_KEY), before);
    make(&Plan { existing: Existing::Replace, ..plan }).expect("made anew");
    assert_ne!(read(folder.path(), CA_KEY), before);
}

#[test]
fn somebody_added_later_is_known_to_the_router_and_has_the_same_authority() {
    let folder = tempfile::tempdir().expect("a folder");
    make(&plan(folder.path(), &EXAMPLES)).expect("made");
    let (authority, users) = (read(folder.path(), CA_CERTIFICATE), read(folder.path(), USERS));
    add(&plan(folder.path(), &[("bob", &[Role::Client])])).expect("added");
    assert_eq!(read(folder.path(), CA_CERTIFICATE), authority);
    assert!(read(folder.path(), USERS).starts_with(&users) && read(folder.path(), USERS).contains("\nbob:"));

    let together = tempfile::tempdir().expect("a folder");
    let mut all = EXAMPLES.to_vec();
    all.push(("bob", &[Role::Client]));
    make(&Plan { at: folder.path().to_owned(), ..plan(together.path(), &all) }).expect("made");
    assert_eq!(read(folder.path(), "router.json5"), read(together.path(), "router.json5"), "as if made at once");
}

#[test]
fn a_new_certificate_for_an_old_member_changes_its_password_and_no_rule() {
    let folder = tempfile::tempdir().expect("a folder");
    make(&plan(folder.path(), &EXAMPLES)).expect("made");
    let (rules, users) = (read(folder.path(), "router.json5"), read(folder.path(), USERS));
    let again = plan(folder.path(), &[("alice", &[Role::Client])]);
    add(&again).expect_err("it has one");
    add(&Plan { existing: Existing::Replace, ..again }).expect("renewed");
    assert_eq!(read(folder.path(), "router.json5"), rules);
    let now = read(folder.path(), USERS);
    assert_eq!(now.lines().count(), users.lines().count());
    let changed: Vec<&str> = now.lines().filter(|line| !users.contains(line)).collect();
    assert!(matches!(changed[..], [line] if line.starts_with("alice:")), "{} lines changed", changed.len());
}

#[test]
fn a_key_that_is_not_the_authoritys_signs_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    make(&plan(folder.path(), &EXAMPLES)).expect("made");
    std::fs::copy(folder.path().join("alice.key.pem"), folder.path().join(CA_KEY)).expect("copied");
    let error = add(&plan(folder.path(), &[("bob", &[Role::Client])])).expect_err("refused").to_string();
    assert!(error.contains("not the key"), "{error}");
}

#[test]
fn names_of_the_labs_own_files_are_reserved_and_a_service_shares_its_name_with_nobody() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, roles) in
        [("router", &[Role::Client][..]), ("ca", &[Role::Camera]), ("w1", &[Role::Service, Role::Client])]
    {
        let error = make(&plan(folder.path(), &[(name, roles)])).expect_err("refused").to_string();
        assert!(error.contains(name), "{error}");
    }
    assert_eq!(folder.path().read_dir().expect("a folder").count(), 0, "nothing was written");
}
