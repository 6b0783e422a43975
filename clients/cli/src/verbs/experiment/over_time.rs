//! Pages of what a run has over time: its order, its measures or its trajectory.

use jostle_client::Client;
use jostle_proto::{OrderPage, SeriesPage};
use serde::de::DeserializeOwned;

use crate::bound::Bound;
use crate::failure::Failure;

/// The most entries that a query may ask for.
const MAX_PAGE_ENTRIES: usize = 40_000;

/// A page of entries.
pub trait Page: DeserializeOwned {
    /// The number of its entries.
    fn count(&self) -> usize;

    /// The number of its last entry, if others follow.
    fn next(&self) -> Option<u64>;

    /// The number of all entries; none from an earlier version.
    fn total(&self) -> Option<u64>;
}

impl Page for OrderPage {
    fn count(&self) -> usize {
        self.time.len()
    }

    fn next(&self) -> Option<u64> {
        self.next
    }

    fn total(&self) -> Option<u64> {
        self.total
    }
}

impl Page for SeriesPage {
    fn count(&self) -> usize {
        self.time.len()
    }

    fn next(&self) -> Option<u64> {
        self.next
    }

    fn total(&self) -> Option<u64> {
        self.total
    }
}

/// The pages of one run, as far as a bound permits.
pub struct Pages<'a> {
    client: &'a Client,
    name: &'a str,
    /// What is queried, of which run, and further parameters.
    query: (&'static str, String, &'static str),
    after: Option<u64>,
}

impl<'a> Pages<'a> {
    /// Begins to query `noun` of the experiment `name`; `of` are further parameters.
    pub fn new(
        client: &'a Client,
        name: &'a str,
        (noun, run, of): (&'static str, &str, &'static str),
    ) -> Self {
        Self {
            client,
            name,
            query: (noun, run.to_owned(), of),
            after: Some(0),
        }
    }

    /// Fetches the next page; none at the end, or if no entry may follow: the others are only counted.
    pub async fn next<P: Page>(&mut self, bound: &mut Bound) -> Result<Option<P>, Failure> {
        let mut counted = 1;
        while let Some(after) = self.after {
            let (noun, run, of) = &self.query;
            let limit = match bound.rest {
                usize::MAX => String::new(),
                0 => format!(";limit={counted}"),
                rest => format!(";limit={}", rest.min(MAX_PAGE_ENTRIES)),
            };
            let noun = format!("{noun}?run={run};after={after}{limit}{of}");
            let page: P = self.client.get_experiment(self.name, &noun).await?.read()?;
            self.after = page.next().filter(|next| *next > after);
            let count = page.count() as u64;
            if bound.rest == 0 {
                // An earlier version does not say how many there are.
                bound.left_out += page.total().map_or(count, |total| total - after);
                if page.total().is_some() {
                    self.after = None;
                }
                counted = MAX_PAGE_ENTRIES;
                continue;
            }
            if bound.rest != usize::MAX {
                bound.rest = bound.rest.saturating_sub(page.count());
            }
            return Ok(Some(page));
        }
        Ok(None)
    }
}
