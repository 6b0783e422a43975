//! A page of every claim with the measured values and the figures. All of its contents are
//! computed.

use std::fmt::Write as _;

use super::{Claim, Evidence, Rule, Verdict, claims, of_difference, rules, with_error};
use crate::contact_statistics::ContactStatistics;
use crate::{Measure, ResultRow};

/// The origin of the results on a page.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The commands that produced the results, one a line.
    pub commands: String,
    /// The figures: their titles and their paths relative to the page.
    pub figures: Vec<(String, String)>,
}

/// A claim and its results, rule by rule.
type Row<'a> = (&'a Claim, Vec<super::ClaimResult>);

/// Writes the page in Markdown. The same results give the same bytes.
#[must_use]
pub fn page(runs: &[ResultRow], contact_rows: &[ContactStatistics], origin: &Origin) -> String {
    let rules = rules(runs);
    let evidence: Vec<Evidence> = rules
        .iter()
        .map(|rule| Evidence::new(rule, runs, contact_rows))
        .collect();
    let claims = claims();
    let rows: Vec<Row> = claims
        .iter()
        .map(|claim| (claim, evidence.iter().map(claim.judge).collect()))
        .collect();
    let mut page = String::new();
    let mut put = |text: &str| page.push_str(text);
    put(HEAD);
    put("<!-- run by: paper/reproduce -->\n");
    put(&format!("```sh\n{}\n```\n\n", origin.commands.trim_end()));
    put(&of_the_rules(runs, &rules));
    put(&summary(&rules, &rows));
    put(&meaning(&rules, &evidence));
    put(
        "## Claim by claim\n\nThe line below each claim is its criterion. Errors (±) are \
         standard errors of means over runs; `2 errors` are\ntwo of them.\n",
    );
    for (claim, results) in &rows {
        put(&format!(
            "\n### {} {}\n\nCriterion: {}.\n\n| contact rule | measured | verdict |\n|---|---|---|\n",
            claim.name, claim.statement, claim.criterion
        ));
        for (rule, result) in rules.iter().zip(results) {
            let (title, verdict) = (title(rule), result.verdict);
            put(&format!("| {title} | {} | {verdict} |\n", result.measured));
        }
    }
    put("\n## Figures\n");
    for (title, place) in &origin.figures {
        put(&format!("\n![{title}]({place})\n"));
    }
    page
}

const HEAD: &str = "\
# The paper's results, reproduced

P. L. Várkonyi, *Communication and collective consensus making in animal groups via mechanical
interactions*, J. Nonlinear Sci. 21 (2011), makes claims about this model. This page compares them with
simulations. The last of these commands writes the whole page from the results of the others:

";

/// The explanation of how a verdict follows from the cases of a claim.
const HOW: &str = "\
A claim is about one or more conditions, and has a criterion with a limit
([claim by claim](#claim-by-claim)). A condition meets or misses the criterion if its measured value is more
than two standard errors from the limit. A claim *holds* if all conditions meet the criterion, and *holds in
part* if at least half of them do and the mean over all conditions is on the claim's side of the limit.
Otherwise it *does not hold*. It is *undecided* if the verdict depends on conditions that are within two
standard errors of the limit.
";

fn title(rule: &Rule) -> String {
    format!("`{}`, dt = {}", rule.contacts, rule.dt)
}

/// Writes the table of the runs of each rule.
fn of_the_rules(runs: &[ResultRow], rules: &[Rule]) -> String {
    let mut table = String::from(
        "The table has the totals of the runs under each contact rule:\n\n| contact rule | runs | steps | \
         runs ended by a fault | share of time with crossed bodies | the same, in the worst condition | \
         deepest overlap | worst residual | degraded steps | calls of the fallback |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for rule in rules {
        let these: Vec<&ResultRow> = runs
            .iter()
            .filter(|run| run.contacts == rule.contacts && run.dt == rule.dt)
            .collect();
        let numbers = |measure| these.iter().map(move |run| run.number(measure));
        let sum = |measure| numbers(measure).sum::<f64>();
        let largest = |measure| numbers(measure).fold(0.0, f64::max);
        let time: f64 = these.iter().map(|run| run.time).sum();
        let crossed = these
            .iter()
            .map(|run| run.number(Measure::CROSSED_SHARE) * run.time);
        let crossed: f64 = crossed.sum();
        let longest = these.iter().map(|run| run.time).fold(0.0, f64::max);
        let ended = these.iter().filter(|run| run.time < longest * (1.0 - 1e-9));
        let conditions =
            crate::statistics::summarise(&these.iter().map(|&run| run.clone()).collect::<Vec<_>>());
        let worst = conditions
            .iter()
            .map(|it| it.crossed_share)
            .fold(0.0, f64::max);
        let _ = writeln!(
            table,
            "| {} | {} | {} | {} | {:.1} % | {:.1} % | {:.2e} | {:.1e} | {} | {} |",
            title(rule),
            these.len(),
            these.iter().map(|run| run.steps).sum::<u64>(),
            ended.count(),
            100.0 * crossed / time,
            100.0 * worst,
            largest(Measure::WORST_OVERLAP),
            largest(Measure::WORST_RESIDUAL),
            sum(Measure::DEGRADED),
            sum(Measure::FALLBACKS),
        );
    }
    table.push('\n');
    table
}

/// Writes the section on the two readings of contacts and their consequences for the paper.
fn meaning(rules: &[Rule], evidence: &[Evidence]) -> String {
    let of = |name: &str| {
        let index = rules.iter().position(|rule| rule.contacts == name)?;
        evidence.get(index)
    };
    let (Some(exact), Some(literal)) = (of("endpoints"), of("closest")) else {
        return String::new();
    };
    let mut text = String::from(
        "## The effect of the contact rule\n\nThe paper states neither its time step nor its \
         treatment of bodies side by side, whose closest points are not unique. `endpoints` constrains every \
         smooth distance of a pair that no smaller distance implies; `closest` follows the appendix of \
         the paper literally, and constrains one distance of each pair. With one constraint, bodies side \
         by side rotate into each other until their axes cross.\n\n| π1, n | rule | v | n_eff | \
         build-up | breakdown | share of time ordered | share of time with crossed bodies |\n|---|---|---|---|---|---|---|---|\n",
    );
    let mut differ = Vec::new();
    for (pi1, n) in [
        (4.0, 10),
        (8.0, 10),
        (4.0, 50),
        (8.0, 50),
        (4.0, 74),
        (8.0, 74),
    ] {
        let (Some(one), Some(other)) = (exact.one(pi1, n), literal.one(pi1, n)) else {
            continue;
        };
        for (rule, it) in [("endpoints", one), ("closest", other)] {
            let time = |it: Option<crate::statistics::Interval>| {
                it.map_or("not always reached".to_owned(), |it| {
                    with_error(it.mean, it.error)
                })
            };
            let _ = writeln!(
                text,
                "| π1 = {pi1}, n = {n} | `{rule}` | {} | {} | {} | {} | {:.2} | {:.2} |",
                with_error(it.v.mean, it.v.error),
                it.n_eff.map_or("-".to_owned(), |size| format!("{size:.1}")),
                time(it.build_up),
                time(it.breakdown),
                it.ordered_share,
                it.crossed_share
            );
        }
        let error = of_difference(one.v.error, other.v.error).unwrap_or(f64::INFINITY);
        let errors = (one.v.mean - other.v.mean) / error;
        if errors > 3.0 {
            differ.push(format!("π1 = {pi1}, n = {n} ({errors:.1} standard errors)"));
        }
    }
    let _ = writeln!(
        text,
        "\n- Order is greater with `endpoints` than with `closest` at {}.",
        if differ.is_empty() {
            "none of these".to_owned()
        } else {
            differ.join(", ")
        }
    );
    if let (Some(one), Some(other)) = (exact.one(4.0, 74), literal.one(4.0, 74)) {
        let shares = [one, other].map(|it| 100.0 * it.ordered_share);
        let _ = writeln!(
            text,
            "- Order decreases with n under both rules, but the extent depends on the rule: groups of 74 with \
             π1 = 4 are ordered {:.1} % of the time with `endpoints` and {:.1} % of the time with \
             `closest`, where some bodies are crossed {:.1} % of the time. So the paper's results for \
             larger groups depend on how its program treated bodies side by side.",
            shares[0],
            shares[1],
            100.0 * other.crossed_share
        );
    }
    text.push_str(
        "- Another time step or another treatment of parallel bodies may give other results: `closest` is \
         an interpretation of the paper, not the paper's program. The paper does not state the number \
         of individuals in its animations. The animations here have 50 individuals and, with `closest`, \
         a time step of 0.05, since bodies at π3 = 10 turn too fast for 0.1.\n\n",
    );
    text
}

/// Writes the table of all verdicts, their totals and the claims whose verdict depends on the rule.
fn summary(rules: &[Rule], rows: &[Row]) -> String {
    let mut text = format!("## Verdicts\n\n{HOW}\n| claim |");
    rules.iter().for_each(|rule| {
        let _ = write!(text, " {} |", title(rule));
    });
    let _ = writeln!(text, "\n|---|{}", "---|".repeat(rules.len()));
    for (claim, results) in rows {
        let _ = write!(text, "| {} {} |", claim.name, claim.statement);
        for result in results {
            let verdict = result.verdict.to_string();
            let verdict = match result.verdict {
                Verdict::Holds => format!("**{verdict}**"),
                _ => verdict,
            };
            let _ = write!(text, " {verdict} |");
        }
        text.push('\n');
    }
    text.push('\n');
    for (index, rule) in rules.iter().enumerate() {
        let count = |verdict| {
            let alike = rows
                .iter()
                .filter(|(_, results)| results[index].verdict == verdict);
            alike.count()
        };
        let _ = writeln!(
            text,
            "- {}: {} hold, {} in part, {} do not, {} are undecided.",
            title(rule),
            count(Verdict::Holds),
            count(Verdict::InPart),
            count(Verdict::Fails),
            count(Verdict::Undecided)
        );
    }
    let depends = |results: &[super::ClaimResult]| {
        results
            .windows(2)
            .any(|pair| pair[0].verdict != pair[1].verdict)
    };
    let dependent: Vec<&str> = rows
        .iter()
        .filter(|(_, results)| depends(results))
        .map(|(claim, _)| claim.name)
        .collect();
    if rules.len() > 1 {
        let _ = writeln!(
            text,
            "- The contact rule changes the verdict of {} of {} claims: {}.",
            dependent.len(),
            rows.len(),
            dependent.join(", ")
        );
    }
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::claims::ClaimResult;

    #[test]
    fn the_summary_lists_verdicts_totals_and_claims_that_depend_on_the_rule() {
        let rules = ["endpoints", "closest"].map(|contacts| Rule {
            contacts: contacts.to_owned(),
            dt: 0.02,
        });
        let claims = claims();
        let of = |verdicts: [Verdict; 2]| {
            let result = |verdict| ClaimResult {
                measured: String::new(),
                verdict,
            };
            verdicts.map(result).to_vec()
        };
        let verdicts = [
            [Verdict::Holds, Verdict::Holds],
            [Verdict::InPart, Verdict::Fails],
            [Verdict::Undecided, Verdict::Holds],
        ];
        let rows: Vec<Row> = claims.iter().zip(verdicts.map(of)).collect();
        let text = summary(&rules, &rows);
        let row = |index: usize, verdicts: &str| {
            let claim = &claims[index];
            format!("\n| {} {} | {verdicts} |\n", claim.name, claim.statement)
        };
        let lines = [
            row(0, "**holds** | **holds**"),
            row(1, "holds in part | does not hold"),
            row(2, "undecided | **holds**"),
            "`endpoints`, dt = 0.02: 1 hold, 1 in part, 0 do not, 1 are undecided.\n".to_owned(),
            "`closest`, dt = 0.02: 2 hold, 0 in part, 1 do not, 0 are undecided.\n".to_owned(),
            format!("2 of 3 claims: {}, {}.\n", claims[1].name, claims[2].name),
        ];
        for line in lines {
            assert!(text.contains(&line), "{line:?} is not in {text}");
        }
    }
}
