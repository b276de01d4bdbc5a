//! Who gets a link at all, and who loses it.

use std::path::Path;

use domvs::certs::{self, Existing, Plan, Role};
use zenoh::Config;

use crate::support::{Lab, Question, is_let_in, lab_config, lab_plan, lab_router};

/// A configuration with other values; each is text, or a JSON object.
fn changed(mut config: Config, entries: &[(&str, &str)]) -> Config {
    for (key, value) in entries {
        let json = if value.starts_with('{') { (*value).to_owned() } else { format!("{value:?}") };
        config.insert_json5(key, &json).expect("a known key");
    }
    config
}

/// Alice's configuration with the authority of one folder, and her certificate and key of another.
fn with_files(lab: &Lab, authority: &Path, own: &Path) -> Config {
    let tls = [("root_ca_certificate", authority.join("ca.pem")), ("connect_certificate", own.join("alice.pem"))];
    let tls = tls.into_iter().chain([("connect_private_key", own.join("alice.key.pem"))]);
    tls.fold(lab.config("alice"), |config, (key, path)| {
        changed(config, &[(&format!("transport/link/tls/{key}"), path.to_str().expect("UTF-8"))])
    })
}

over_tls! {
    async fn who_cannot_prove_its_name_gets_no_link() {
        let lab = Lab::open().await;
        let folder = tempfile::tempdir().expect("a folder");
        certs::make(&lab_plan(folder.path(), &[("alice", Role::Client)])).expect("another lab");
        let (own, other) = (lab.folder.path(), folder.path());
        let authority = format!("{{ root_ca_certificate: {:?} }}", own.join("ca.pem"));
        let plain = format!("{{ endpoints: [{:?}] }}", lab.endpoint.replace("tls/", "tcp/"));
        let alice = |entries: &[(&str, &str)]| changed(lab.config("alice"), entries);
        let refused = [
            ("a wrong password", alice(&[("transport/auth/usrpwd/password", "00112233445566778899aabbccddeeff")])),
            ("an unknown user", alice(&[("transport/auth/usrpwd/user", "mallory")])),
            ("no user", alice(&[("transport/auth/usrpwd", "{}")])),
            ("a certificate of another lab", with_files(&lab, own, other)),
            ("trust in another lab's router", with_files(&lab, other, own)),
            ("no certificate", alice(&[("transport/link/tls", &authority)])),
            ("plain TCP", changed(Config::default(), &[("mode", "client"), ("connect", &plain)])),
        ];
        assert!(is_let_in(alice(&[])).await, "the same attempt with the right files");
        assert!(is_let_in(with_files(&lab, own, own)).await, "and with the files named anew");
        for (what, config) in refused {
            assert!(!is_let_in(config).await, "{what}");
        }
        lab.close().await;
    }
}

over_tls! {
    async fn a_certificate_with_anothers_password_has_no_rights() {
        let lab = Lab::open().await;
        let text = std::fs::read_to_string(lab.folder.path().join("users.txt")).expect("it is there");
        let bobs = text.lines().find_map(|line| line.strip_prefix("bob:")).expect("bob has a password");
        let mixed =
            changed(lab.config("alice"), &[("transport/auth/usrpwd", &format!("{{ user: \"bob\", password: {bobs:?} }}"))]);
        let session = zenoh::open(mixed).await.expect("certificate and password are good, each by itself");
        assert!(Question::on("domvs/worker/*/info").ask_all(&session).await.is_empty());
        let alice = lab.client("alice").await;
        assert_eq!(alice.list_workers().await.expect("asked").len(), 1);
        lab.close().await;
    }
}

over_tls! {
    async fn a_member_is_added_and_locked_out_by_restarting_the_router() {
        let folder = tempfile::tempdir().expect("a folder");
        certs::make(&lab_plan(folder.path(), &[("alice", Role::Client), ("bob", Role::Client)])).expect("made");
        certs::add(&lab_plan(folder.path(), &[("carol", Role::Client)])).expect("added");
        let users = folder.path().join("users.txt");
        let text = std::fs::read_to_string(&users).expect("it is there");
        let without: String =
            text.lines().filter(|line| !line.starts_with("bob:")).map(|line| format!("{line}\n")).collect();
        std::fs::write(&users, without).expect("written");
        let renewed = Plan { existing: Existing::Replace, ..lab_plan(folder.path(), &[("alice", Role::Client)]) };
        std::fs::copy(folder.path().join("alice.json5"), folder.path().join("old.json5")).expect("copied");
        certs::add(&renewed).expect("renewed");

        let (router, endpoint) = lab_router(folder.path(), &[]).await;
        for (who, expected) in [("carol", true), ("bob", false), ("alice", true), ("old", false)] {
            assert_eq!(is_let_in(lab_config(folder.path(), who, &endpoint)).await, expected, "{who}");
        }
        router.close().await.expect("the router closes");
    }
}
