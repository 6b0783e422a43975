//! Who one is to the daemon.

use jostle_proto::role::refused;
use jostle_proto::{NodeReply, WhoAmI};

use crate::arguments::AuthVerb;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::output::Output;

/// Says who one is and what one may.
///
/// # Errors
///
/// What the daemon says, or that something is not permitted.
pub async fn auth(bus: &Bus, output: Output, what: &AuthVerb) -> Result<(), Failure> {
    if let AuthVerb::Link { page } = what {
        return link(bus, output, page);
    }
    let answer = bus.get_node("whoami").await?;
    let NodeReply { node, result: who } = answer.read::<NodeReply<WhoAmI>>()?;
    match what {
        AuthVerb::Can { verb } => {
            if !who.verbs.contains(verb) && !who.node_verbs.contains(verb) {
                let person = who.person.as_deref().zip(who.role);
                return Err(Failure::refused(refused(person, verb)));
            }
            match output.json {
                true => output.data(answer.json()?),
                false => output.data(&format!("you may {verb}")),
            }
        }
        _ if output.json => output.data(answer.json()?),
        _ => output.data(&told(&node, &who, bus.token().is_some())),
    }
}

/// Who one is, in words.
fn told(node: &str, who: &WhoAmI, has_token: bool) -> String {
    let may = |verbs: &[String]| match verbs {
        [] => "nothing".to_owned(),
        verbs => verbs.join(", "),
    };
    let first = match (&who.person, who.role) {
        (Some(person), Some(role)) => format!("{person}, {role} on {node}"),
        (None, Some(_)) => format!("{node} knows no people: whoever reaches it may do everything"),
        _ if has_token => format!("nobody that {node} knows: these credentials are out of date"),
        _ => format!("nobody that {node} knows: --credentials FOLDER says who you are"),
    };
    format!(
        "{first}\nof swarms: watch{}{}\nof the daemon: {}",
        if who.verbs.is_empty() { "" } else { ", " },
        who.verbs.join(", "),
        may(&who.node_verbs)
    )
}

/// The link to the page, which the token opens. It is what was asked for, and goes nowhere else.
fn link(bus: &Bus, output: Output, page: &str) -> Result<(), Failure> {
    let Some(token) = bus.token() else {
        return Err(Failure::Argument {
            argument: "--credentials".into(),
            problem: "is not given, and the token in the link is theirs".into(),
        });
    };
    output.data(&format!("{}/#token={token}", page.trim_end_matches('/')))
}
