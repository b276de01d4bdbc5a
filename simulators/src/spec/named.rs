//! The worlds that come with the crate, by name: `worlds/*.toml`.

use super::error::SpecError;

/// Name and text, in the order they are listed.
const WORLDS: [(&str, &str); 14] = [
    ("object", include_str!("../../worlds/object.toml")),
    ("plane", include_str!("../../worlds/plane.toml")),
    ("boxes", include_str!("../../worlds/boxes.toml")),
    ("object2", include_str!("../../worlds/object2.toml")),
    ("bricks", include_str!("../../worlds/bricks.toml")),
    ("terrain", include_str!("../../worlds/terrain.toml")),
    ("experiment2", include_str!("../../worlds/experiment2.toml")),
    ("experiment3", include_str!("../../worlds/experiment3.toml")),
    ("experiment6", include_str!("../../worlds/experiment6.toml")),
    ("experiment7", include_str!("../../worlds/experiment7.toml")),
    ("experiment7_light", include_str!("../../worlds/experiment7_light.toml")),
    ("case1", include_str!("../../worlds/case1.toml")),
    ("case2", include_str!("../../worlds/case2.toml")),
    ("case3", include_str!("../../worlds/case3.toml")),
];

/// The names that [`super::WorldSpec::named`] knows.
pub fn named_worlds() -> Vec<&'static str> {
    WORLDS.iter().map(|(name, _)| *name).collect()
}

pub(super) fn text(name: &str) -> Result<&'static str, SpecError> {
    let found = WORLDS.iter().find(|(known, _)| *known == name);
    found.map(|(_, text)| *text).ok_or_else(|| SpecError::UnknownWorld { name: name.to_owned() })
}
