//! The promises of docs/safety.md, held where they are made: a task, its outlet and a clock that is an argument; no network.
//!
//! Random worlds are made from a fixed seed, so every run is the same. `DOMVS_CASES` says how many of each kind, if not the few that
//! are quick: `DOMVS_CASES=5000 cargo test --release -p domvs-server --test safety`.

mod anything;
mod documents;
mod life;
mod pictures;
mod properties;
mod statuses;
mod world;
