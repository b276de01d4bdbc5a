//! What the paper promises, one test per promise, against independent judges: literal double sums, values made at 60 to 200 digits,
//! images rendered by ray casting. The data's way, file by file: bases, windows and orders, sums, motion, the servo.

#![expect(clippy::unwrap_used, reason = "a test stops where something that must hold does not")]

mod arbitrary;
mod golden;
mod judge;
mod light;
mod literal_sums;
mod motion;
mod options;
mod paths;
mod pixels;
mod reference;
mod scenes;
mod servo;
mod weights;
