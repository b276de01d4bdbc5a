//! Tchebichef: `w(u) = 1`, Table I (Hahn with `a = b = 0`): no window.

use crate::family::{Family, Rows};
use crate::law::Law;
use crate::window::{Brightness, NoBrightness};

/// Tchebichef rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tchebichef;

impl Family for Tchebichef {
    const WORD: &'static str = "tchebichef";
    const ROWS: Rows<Tchebichef> = Rows::UnderWeight(|_, _, _| 1.0);

    fn choose(_: &Law, _: &Brightness, _: &Brightness) -> Result<[Tchebichef; 2], NoBrightness> {
        Ok([Tchebichef; 2])
    }
}
