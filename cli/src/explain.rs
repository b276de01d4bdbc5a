//! An error as one sentence for people: its causes from the outside in, each said once.
//!
//! Some errors repeat their cause in their own words, and Zenoh ends its sentences with a place in its source
//! (`at /…/orchestrator.rs:447.`). Neither helps whoever reads the terminal.

/// The causes of `error` joined by `: `, without what the one before has said already.
pub fn explained(error: &anyhow::Error) -> String {
    let mut said: Vec<String> = Vec::new();
    for cause in error.chain() {
        let cause = without_source_places(&cause.to_string());
        if said.last().is_none_or(|before| !before.contains(&cause)) {
            said.push(cause);
        }
    }
    said.join(": ")
}

/// Takes every ` at /….rs:123.` out of the text.
fn without_source_places(text: &str) -> String {
    let mut parts = text.split(" at /");
    let mut kept = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        match part.split_once(".rs:") {
            Some((place, rest)) if !place.contains(char::is_whitespace) => {
                let rest = rest.trim_start_matches(|digit: char| digit.is_ascii_digit());
                kept.push_str(rest.strip_prefix('.').unwrap_or(rest));
            }
            _ => kept.extend([" at /", part]),
        }
    }
    kept.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_that_was_said_already_is_not_said_again() {
        let error = anyhow::anyhow!("no such file").context("cannot read a.png: no such file").context("--texture");
        assert_eq!(explained(&error), "--texture: cannot read a.png: no such file");
    }

    #[test]
    fn places_in_the_source_are_left_out_and_paths_of_files_stay() {
        let text = "no listener: [in use (os error 98) at /x/y-1.0/src/tcp.rs:61.] at /x/src/unicast.rs:4.";
        assert_eq!(without_source_places(text), "no listener: [in use (os error 98)]");
        let text = "look at /etc/domvs/server.toml";
        assert_eq!(without_source_places(text), text);
    }
}
