//! Colours on the terminal, decided once from `--color`, `NO_COLOR` and where the output goes, and text that
//! survives a reader who stops reading (`domvs … | head`).

use std::ffi::{OsStr, OsString};
use std::io::{self, IsTerminal, Write};

use clap::ValueEnum;
use comfy_table::{Attribute, Cell, Color, ContentArrangement, Table};

/// `--color`: when to use colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ColorWhen {
    /// On a terminal, unless `NO_COLOR` is set
    #[default]
    Auto,
    /// Even into a file or a pipe
    Always,
    /// Never
    Never,
}

impl ColorWhen {
    /// `--color` among raw arguments: clap colours its own help and errors before it has parsed anything.
    pub fn among(arguments: impl IntoIterator<Item = OsString>) -> ColorWhen {
        let mut arguments = arguments.into_iter();
        let mut found = ColorWhen::Auto;
        while let Some(argument) = arguments.next() {
            let Some(argument) = argument.to_str() else {
                continue;
            };
            let value = match argument.strip_prefix("--color=") {
                Some(value) => Some(value.to_owned()),
                None if argument == "--color" => arguments.next().and_then(|value| value.into_string().ok()),
                None => None,
            };
            if let Some(when) = value.and_then(|value| ColorWhen::from_str(&value, true).ok()) {
                found = when;
            }
        }
        found
    }

    /// The same choice in clap's own type.
    pub fn for_clap(self) -> clap::ColorChoice {
        match self {
            ColorWhen::Auto => clap::ColorChoice::Auto,
            ColorWhen::Always => clap::ColorChoice::Always,
            ColorWhen::Never => clap::ColorChoice::Never,
        }
    }

    fn decide(self, terminal: bool, no_color: Option<&OsStr>) -> Paint {
        let colored = match self {
            ColorWhen::Always => true,
            ColorWhen::Never => false,
            ColorWhen::Auto => terminal && no_color.is_none_or(|value| value.is_empty()),
        };
        Paint { colored }
    }
}

/// Terminals below this many columns get tables as wide as they need.
const NARROWEST: u16 = 20;

/// Whether one output stream gets colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Paint {
    /// Colours and bold text may be written.
    pub colored: bool,
}

impl Paint {
    /// For what goes to standard output.
    pub fn for_stdout(when: ColorWhen) -> Paint {
        when.decide(io::stdout().is_terminal(), std::env::var_os("NO_COLOR").as_deref())
    }

    /// For what goes to standard error: the live line, logs, errors.
    pub fn for_stderr(when: ColorWhen) -> Paint {
        when.decide(io::stderr().is_terminal(), std::env::var_os("NO_COLOR").as_deref())
    }

    /// Bold text.
    pub fn bold(self, text: &str) -> String {
        self.wrap("1", text)
    }

    /// Good news.
    pub fn good(self, text: &str) -> String {
        self.wrap("1;32", text)
    }

    /// Bad news.
    pub fn bad(self, text: &str) -> String {
        self.wrap("1;31", text)
    }

    fn wrap(self, code: &str, text: &str) -> String {
        if self.colored { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
    }

    /// A table with the given headings, as wide as the terminal at most; colours only where `self` allows them.
    pub fn table(self, headings: &[&str]) -> Table {
        let mut table = Table::new();
        table.load_preset(comfy_table::presets::UTF8_HORIZONTAL_ONLY);
        // Some pseudo terminals say that they have no columns at all; nothing can be fitted into that.
        if table.width().is_none_or(|columns| columns >= NARROWEST) {
            table.set_content_arrangement(ContentArrangement::Dynamic);
        }
        if self.colored {
            table.enforce_styling();
        }
        table.set_header(headings.iter().map(|heading| self.bold_cell(heading)));
        table
    }

    /// A table cell in bold.
    pub fn bold_cell(self, text: &str) -> Cell {
        let cell = Cell::new(text);
        if self.colored { cell.add_attribute(Attribute::Bold) } else { cell }
    }

    /// A table cell that says how something ended: green or red.
    pub fn verdict_cell(self, text: &str, good: bool) -> Cell {
        let color = if good { Color::Green } else { Color::Red };
        if self.colored { Cell::new(text).fg(color) } else { Cell::new(text) }
    }
}

/// Writes a line (or lines) to standard output. A reader who closed the pipe is no error.
///
/// # Errors
/// Fails when standard output cannot be written to for another reason, for example a full disk.
pub fn print_line(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn among(arguments: &[&str]) -> ColorWhen {
        ColorWhen::among(arguments.iter().map(OsString::from))
    }

    #[test]
    fn the_color_option_is_found_before_parsing_in_both_spellings() {
        assert_eq!(among(&["domvs", "--color", "never", "twist"]), ColorWhen::Never);
        assert_eq!(among(&["domvs", "twist", "--color=always"]), ColorWhen::Always);
        assert_eq!(among(&["domvs", "--color"]), ColorWhen::Auto);
        assert_eq!(among(&["domvs", "--color", "purple"]), ColorWhen::Auto);
    }

    #[test]
    fn auto_means_a_terminal_without_no_color() {
        let auto = ColorWhen::Auto;
        assert!(auto.decide(true, None).colored);
        assert!(auto.decide(true, Some(OsStr::new(""))).colored, "an empty NO_COLOR counts as unset");
        assert!(!auto.decide(true, Some(OsStr::new("1"))).colored);
        assert!(!auto.decide(false, None).colored);
    }

    #[test]
    fn an_explicit_choice_beats_no_color_and_pipes() {
        assert!(ColorWhen::Always.decide(false, Some(OsStr::new("1"))).colored);
        assert!(!ColorWhen::Never.decide(true, None).colored);
    }

    #[test]
    fn without_colours_there_is_no_escape_sequence() {
        let paint = Paint { colored: false };
        let mut table = paint.table(&["method"]);
        table.add_row([paint.verdict_cell("converged", true)]);
        assert!(!table.to_string().contains('\x1b'));
        assert_eq!(paint.bad("error"), "error");
        assert!(Paint { colored: true }.bad("error").contains('\x1b'));
    }
}
