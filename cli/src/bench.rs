//! What a laboratory measures to see whether its machine keeps up. The data's way: [`cases`] (what is measured) → [`scene`] (on which images) →
//! [`step`] (the law alone), or [`place`] (a worker and an echo as processes of their own) → [`roundtrip`] or [`load`] → [`rows`]. [`soak`] asks whether all holds
//! when much goes wrong at once.
//!
//! Times are by the wall, and every comparison is of things that took turns within one run: what disturbs one disturbs the other.

pub mod cases;

pub mod scene;

pub mod samples;

pub mod rows;

pub mod watch;

pub mod peak;

pub mod step;

pub mod echo;

pub mod place;

pub mod process;

pub mod roundtrip;

pub mod cameras;

pub mod load;

pub mod soak;
