//! `jostled auth`: who may do what.

use std::path::PathBuf;

use clap::Subcommand;
use jostle_proto::Role;
use jostled::rights::folder::{Folder, People};
use jostled::rights::issue;
use serde_json::json;

/// What is to be done.
#[derive(Subcommand)]
pub enum Auth {
    /// Make what is not there yet: a private certificate authority, the daemon's certificate, people.
    Init {
        /// A name or an address by which other machines reach the daemon; once for each, and all of
        /// them each time: the daemon's certificate is made anew for these.
        #[arg(long = "host", value_name = "HOST")]
        hosts: Vec<String>,
        /// People, and what each is: viewer, controller or operator.
        #[arg(value_name = "NAME=ROLE", value_parser = person)]
        people: Vec<(String, Role)>,
    },
    /// Add people.
    Add {
        /// People, and what each is: viewer, controller or operator.
        #[arg(value_name = "NAME=ROLE", value_parser = person, required = true)]
        people: Vec<(String, Role)>,
    },
    /// Take people's rights away.
    Remove {
        /// Who.
        #[arg(value_name = "NAME", required = true)]
        names: Vec<String>,
    },
    /// Say who there is, what they are, and until when their certificates hold.
    List {
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Makes, changes or tells who may do what, in `folder`. Returns what there is to say.
///
/// # Errors
///
/// An exit code, and what is wrong.
pub fn give_rights(folder: &str, command: &Auth) -> Result<String, (u8, String)> {
    if folder.is_empty() {
        let problem = "say where: --auth-dir FOLDER, or auth_dir in the settings";
        return Err((2, problem.to_owned()));
    }
    let folder = Folder::at(PathBuf::from(folder));
    let done = match command {
        Auth::Init { hosts, people } => issue::init(&folder, hosts, people).map(|it| handed(&it)),
        Auth::Add { people } => issue::add(&folder, people).map(|it| handed(&it)),
        Auth::Remove { names } => issue::remove(&folder, names).map(|()| {
            let mut who = names.clone();
            who.sort();
            who.dedup();
            let who = who.join(", ");
            format!("{who}: gone, from the daemon's next start on\n")
        }),
        Auth::List { json } => folder.people().map(|known| listed(&known, *json)),
    };
    done.map_err(|error| (1, error.to_string()))
}

/// Who there is, for people or for programs.
fn listed(known: &People, as_json: bool) -> String {
    let people = known.people.iter();
    if as_json {
        let people: Vec<_> = people
            .map(|it| json!({"person": it.person, "role": it.role, "until": it.until}))
            .collect();
        let told = json!({"people": people, "daemon_until": known.until});
        return format!("{told}\n");
    }
    let until = |day: &Option<String>| {
        let told = day.as_ref().map(|day| format!("until {day}"));
        told.unwrap_or_default()
    };
    let line = |what: &str, who: &str, day| {
        let line = format!("{what:12} {who:20} {}", until(day));
        format!("{}\n", line.trim_end())
    };
    let all: String = people
        .map(|it| line(it.role.name(), &it.person, &it.until))
        .collect();
    all + &line("(daemon)", "", &known.until)
}

/// What to do with the folders of new people.
fn handed(folders: &[PathBuf]) -> String {
    if folders.is_empty() {
        return "all is there; `jostled auth add NAME=ROLE` adds people\n".into();
    }
    let mut told =
        String::from("hand each folder to its person, over a safe way, and delete it here:\n");
    for folder in folders {
        told += &format!("  {}\n", folder.display());
    }
    told += "they name it: jostle --credentials FOLDER …; the daemon knows them from its next start on\n";
    told
}

/// Reads `anna=operator`.
fn person(text: &str) -> Result<(String, Role), String> {
    let roles = Role::ALL.map(Role::name).join(", ");
    let (name, role) = text
        .split_once('=')
        .ok_or_else(|| format!("give NAME=ROLE, a role being one of {roles}"))?;
    let role = Role::ALL.into_iter().find(|known| known.name() == role);
    let role = role.ok_or_else(|| format!("a role is one of {roles}"))?;
    Ok((name.to_owned(), role))
}
