//! The laboratory behind `domvs experiment`: files of runs, the runs, what they leave.
//!
//! The data's way: [`spec`] (a TOML file, or a [`named`] one) → [`plan`] (every run, nothing left to look up) → [`world`] +
//! [`service`] → [`runner`] (image, twist, move, next image) → [`outcome`] (one run) → [`cells`] (rates with their
//! [`wilson`] intervals) → [`document`] (held against the paper's [`claims`]). [`pool`] runs many at once, [`store`] keeps what is done.
//!
//! A run is a pure function of its plan: no clock, no thread of its own, the same on one core or many, in this process or
//! through the real service.

pub mod named;
pub mod plan;
pub mod spec;

pub mod service;
pub mod world;

pub mod landscape;
pub mod outcome;
pub mod parameters;
pub mod runner;

pub mod cells;
pub mod claims;
pub mod document;
pub mod page;
pub mod rates;
pub mod shown;
pub mod summary;
pub mod wilson;

pub mod pool;
pub mod progress;
pub mod store;
