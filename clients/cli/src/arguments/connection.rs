//! The options that select a daemon and the form of the output.

use std::path::PathBuf;

use clap::Args;
use clap::builder::TypedValueParser as _;
use jostle_proto::keys::DEFAULT_PREFIX;

use crate::values;

/// The options that several verbs have.
#[derive(Debug, Args)]
#[command(next_help_heading = "Connection and output")]
pub struct GlobalArguments {
    /// The endpoint of the daemon [default: the one in the credentials, or tcp/127.0.0.1:7447]
    #[arg(short, long, env = "JOSTLE_ENDPOINT", hide_env_values = true)]
    pub endpoint: Option<String>,
    /// Folder with your credentials, as written by `jostled auth`
    #[arg(
        long,
        env = "JOSTLE_CREDENTIALS",
        hide_env_values = true,
        value_name = "FOLDER",
        value_parser = clap::builder::OsStringValueParser::new().map(PathBuf::from),
        value_hint = clap::ValueHint::DirPath
    )]
    pub credentials: Option<PathBuf>,
    /// The name of the daemon, if the endpoint reaches several
    #[arg(long, value_name = "NAME", value_parser = values::name)]
    pub node: Option<String>,
    /// The prefix of the daemon's keys
    #[arg(long, value_name = "NAME", default_value = DEFAULT_PREFIX, value_parser = values::name)]
    pub prefix: String,
    /// How long to wait for a reply; the daemon executes the request even after a timeout.
    /// `wait` and `run --wait` have no limit by default
    #[arg(long, value_name = "SECS", default_value = "5", value_parser = values::seconds, allow_negative_numbers = true)]
    pub timeout: f64,
    /// Whether the timeout is given, not the default.
    #[arg(skip)]
    pub is_timeout_given: bool,
    /// Print replies as JSON, and streams as JSON Lines
    #[arg(long)]
    pub json: bool,
}
