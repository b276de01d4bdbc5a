//! The methods a client may choose: one line each, from which the enum, its JSON, the settings table, `--help` and a
//! worker's info come.

use serde::{Deserialize, Serialize};

/// Makes the enum and its lists. `moments` are compared up to an order; `pixels` have no order and no window.
macro_rules! methods {
    ($($(#[$default:meta])? $name:ident $word:literal $of:ident $about:literal)*) => {
        /// What is compared between the images.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum Method {
            $(
                #[doc = $about]
                #[serde(rename = $word)]
                $(#[$default])?
                $name,
            )*
        }

        impl Method {
            /// Every method of this version.
            pub const ALL: [Method; [$($word),*].len()] = [$(Method::$name),*];

            /// The word in JSON and on the command line.
            pub fn word(self) -> &'static str {
                match self {
                    $(Method::$name => $word,)*
                }
            }

            /// What it compares, in a few words.
            pub fn about(self) -> &'static str {
                match self {
                    $(Method::$name => $about,)*
                }
            }

            /// Whether it compares moments up to an order, rather than the pixels themselves.
            pub fn is_of_moments(self) -> bool {
                match self {
                    $(Method::$name => methods!(@ $of),)*
                }
            }
        }

        /// The words, for the table of settings.
        pub(super) const WORDS: &str = methods!(@words $($word)*);
    };
    (@ moments) => { true };
    (@ pixels) => { false };
    (@words $first:literal $($word:literal)*) => { concat!("`", $first, "`" $(, ", `", $word, "`")*) };
}

methods! {
    #[default]
    Hahn            "hahn"             moments "Hahn moments: a window that may move with the object"
    Krawtchouk      "krawtchouk"       moments "Krawtchouk moments: a narrow window around the object, for small displacements"
    Tchebichef      "tchebichef"       moments "Tchebichef moments: the whole image, evenly"
    Cosine          "cosine"           moments "Cosine (DCT) coefficients: the whole image, evenly"
    Photometric     "photometric"      pixels  "The pixels themselves, for small displacements"
    GaussianMixture "gaussian_mixture" pixels  "The images under a Gaussian blur of gaussian_px"
}
