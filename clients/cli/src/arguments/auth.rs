//! What may be typed about who one is.

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use jostle_proto::keys;

/// What may be permitted: all that changes something.
fn verbs() -> impl Iterator<Item = &'static str> {
    keys::SWARM_VERBS.into_iter().chain(keys::NODE_VERBS)
}

/// Who one is.
#[derive(Debug, Args)]
pub struct AuthArguments {
    /// What to do.
    #[command(subcommand)]
    pub what: AuthVerb,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum AuthVerb {
    /// Says who the daemon takes you for, and what you may
    Whoami,
    /// Says whether you may have a verb executed; if not, ends with code 5
    Can {
        /// The verb, such as `pause`
        #[arg(value_parser = PossibleValuesParser::new(verbs()), hide_possible_values = true)]
        verb: String,
    },
    /// Prints the link that opens the daemon's page as you
    Link {
        /// Where the daemon serves HTTP [default: what the daemon says]
        #[arg(long, value_name = "URL")]
        page: Option<String>,
    },
}
