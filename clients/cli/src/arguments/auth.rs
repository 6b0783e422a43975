//! The arguments of `auth`.

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use jostle_proto::keys;

/// The verbs that every role permits.
pub const READS: [&str; 2] = ["wait", "watch"];

/// The verbs that a role may permit: those, and all that change something.
fn verbs() -> impl Iterator<Item = &'static str> {
    let changes = keys::SWARM_VERBS.into_iter().chain(keys::NODE_VERBS);
    changes.chain(READS)
}

#[derive(Debug, Args)]
pub struct AuthArguments {
    #[command(subcommand)]
    pub what: AuthVerb,
}

/// The verb.
#[derive(Debug, Subcommand)]
pub enum AuthVerb {
    /// Shows your identity on the daemon, and your permissions
    Whoami,
    /// Checks whether you may execute a verb; if not, exits with code 5
    Can {
        /// The verb, such as `pause`
        #[arg(value_parser = PossibleValuesParser::new(verbs()), hide_possible_values = true)]
        verb: String,
    },
    /// Prints the link to the daemon's page with your token
    Link {
        /// The HTTP URL of the daemon [default: the one that the daemon reports]
        #[arg(long, value_name = "URL")]
        page: Option<String>,
    },
}
