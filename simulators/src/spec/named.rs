//! The worlds that come with the crate, by name: `worlds/*.toml`.

use super::error::SpecError;

/// Name and text, in the order they are listed.
const WORLDS: [(&str, &str); 3] = [
    ("object", include_str!("../../worlds/object.toml")),
    ("plane", include_str!("../../worlds/plane.toml")),
    ("boxes", include_str!("../../worlds/boxes.toml")),
];

/// The names that [`super::WorldSpec::named`] knows.
pub fn named_worlds() -> Vec<&'static str> {
    WORLDS.iter().map(|(name, _)| *name).collect()
}

pub(super) fn text(name: &str) -> Result<&'static str, SpecError> {
    let found = WORLDS.iter().find(|(known, _)| *known == name);
    found.map(|(_, text)| *text).ok_or_else(|| SpecError::UnknownWorld { name: name.to_owned() })
}
