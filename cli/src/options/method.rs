//! `--method`: what is compared, by the words of the wire.

use std::fmt;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use domvs_proto::settings::Method;

/// `--method`: one of the methods that tasks have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MethodOption(pub Method);

impl MethodOption {
    const ALL: [MethodOption; Method::ALL.len()] = {
        let mut all = [MethodOption(Method::ALL[0]); Method::ALL.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = MethodOption(Method::ALL[i]);
            i += 1;
        }
        all
    };

    /// The word on the command line and on the wire.
    pub fn word(self) -> &'static str {
        self.0.word()
    }

    /// The same method as the law knows it.
    pub fn of_the_law(self) -> domvs_vision::Method {
        domvs_server::law::method(self.0)
    }
}

impl ValueEnum for MethodOption {
    fn value_variants<'a>() -> &'a [MethodOption] {
        &MethodOption::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.word()).help(self.0.about()))
    }
}

impl fmt::Display for MethodOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}
