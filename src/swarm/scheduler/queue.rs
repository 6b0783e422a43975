//! Who computes next: turns are shared between users, and the turns of a user between their swarms.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The processor time by which a user who computes may have taken less than others, and then comes first:
/// as long as a few turns in which swarms of many individuals take one step each.
const MAX_CREDIT: Duration = Duration::from_millis(100);

/// The user to whom a swarm belongs; `None` is nobody, who counts as one user.
pub(super) type Owner = Option<Arc<str>>;

/// The swarms that compute, and those that wait for it.
pub(super) struct Queue {
    /// Turns at once while the swarms of one user compute.
    max_turns: usize,
    /// Turns at once while those of several users do. There are no more threads than cores then: the
    /// kernel would give more to a user with more threads, or with threads of a lower niceness.
    max_shared: usize,
    turns: usize,
    /// An entry stays when the last swarm of a user is deleted; there are as many as users.
    accounts: BTreeMap<Owner, Account>,
    /// What the user had taken whose swarm was called last.
    virtual_time: Duration,
    arrivals: u64,
}

/// The swarms of one user.
#[derive(Default)]
pub(super) struct Account {
    /// Processor time that its swarms took while others waited.
    pub(super) taken: Duration,
    turns: usize,
    /// Ordered by virtual time, then by arrival.
    waiters: BTreeMap<Place, Arc<Waiter>>,
    /// Virtual time of the queue: that of the waiter that was called last, or of a swarm that
    /// computed while none waited.
    pub(super) virtual_time: Duration,
}

/// The place of a waiter: its virtual time and its number of arrival.
pub(super) type Place = (Duration, u64);

/// Wakes the thread of a swarm when it has its turn.
pub(super) struct Waiter {
    pub(super) is_called: AtomicBool,
    pub(super) wake: Box<dyn Fn() + Send + Sync>,
}

impl Account {
    /// Virtual time of its first waiter.
    pub(super) fn first(&self) -> Option<Duration> {
        let ((time, _), _) = self.waiters.first_key_value()?;
        Some(*time)
    }

    fn is_computing(&self) -> bool {
        self.turns > 0 || !self.waiters.is_empty()
    }
}

impl Queue {
    pub(super) fn new(max_turns: usize, max_shared: usize) -> Self {
        Queue {
            max_turns,
            max_shared,
            turns: 0,
            accounts: BTreeMap::new(),
            virtual_time: Duration::ZERO,
            arrivals: 0,
        }
    }

    pub(super) fn account(&mut self, owner: &Owner) -> &mut Account {
        self.accounts.entry(owner.clone()).or_default()
    }

    fn has_waiters(&self) -> bool {
        self.accounts.values().any(|it| !it.waiters.is_empty())
    }

    /// Whether a swarm that keeps its rate may have to wait.
    pub(super) fn is_contended(&self) -> bool {
        self.has_waiters() || (self.accounts.len() > 1 && self.users() > 0)
    }

    /// What the user has taken who has taken least of the others whose swarms compute or wait.
    pub(super) fn least_taken_of_others(&self, owner: &Owner) -> Option<Duration> {
        let others = self.accounts.iter().filter(|(it, _)| *it != owner);
        let computing = others.filter(|(_, account)| account.is_computing());
        computing.map(|(_, account)| account.taken).min()
    }

    /// Charges a user with processor time. A user of whom no swarm waits may have had all that it needed:
    /// what it did not use is credit for a short time only.
    pub(super) fn charge(&mut self, owner: &Owner, taken: Duration) {
        let least = self.virtual_time.saturating_sub(MAX_CREDIT);
        let account = self.account(owner);
        if account.waiters.is_empty() {
            account.taken = account.taken.max(least);
        }
        account.taken += taken;
    }

    /// Does not charge what was computed while no swarm waited.
    pub(super) fn skip_uncontended_time(&mut self, owner: &Owner, virtual_time: Duration) {
        let has_waiters = self.has_waiters();
        let account = self.account(owner);
        if account.waiters.is_empty() {
            account.virtual_time = account.virtual_time.max(virtual_time);
        }
        let taken = account.taken;
        if !has_waiters {
            self.virtual_time = self.virtual_time.max(taken);
        }
    }

    /// Takes a free turn, if there is one for a swarm of this user.
    pub(super) fn take_turn(&mut self, owner: &Owner) -> bool {
        let users = self.users_with(owner);
        let is_free = self.turns < self.limit(users);
        if is_free {
            self.turns += 1;
            self.account(owner).turns += 1;
        }
        is_free
    }

    /// Whether a swarm of this user must end its turn: since a waiter comes first, or since its user has
    /// more turns than its share.
    pub(super) fn must_yield(&mut self, owner: &Owner, virtual_time: Duration) -> bool {
        let users = self.users_with(owner);
        let (turns, taken) = (self.account(owner).turns, self.account(owner).taken);
        let most = self.accounts.values().map(|it| it.turns).max();
        if self.turns > self.limit(users) && Some(turns) == most {
            return true;
        }
        let comes_first = |(other, account): (&Owner, &Account)| match account.first() {
            None => false,
            Some(first) if other == owner => first <= virtual_time,
            Some(_) => {
                account.turns + 1 < turns || (account.turns + 1 == turns && account.taken < taken)
            }
        };
        self.accounts.iter().any(comes_first)
    }

    /// Returns the place of a new waiter.
    pub(super) fn enqueue(
        &mut self,
        owner: &Owner,
        virtual_time: Duration,
        waiter: Arc<Waiter>,
    ) -> Place {
        self.arrivals += 1;
        let place = (virtual_time, self.arrivals);
        self.account(owner).waiters.insert(place, waiter);
        place
    }

    /// Removes a waiter. Returns whether it was there.
    pub(super) fn remove(&mut self, owner: &Owner, place: &Place) -> bool {
        self.account(owner).waiters.remove(place).is_some()
    }

    /// Ends a turn of a swarm of this user. If the user has others, it goes to one who has none, even if
    /// there are more turns than now allowed. Returns the waiter, which must be woken.
    pub(super) fn end_turn(&mut self, owner: &Owner) -> Option<Arc<Waiter>> {
        self.turns -= 1;
        let account = self.account(owner);
        account.turns -= 1;
        let has_others = account.turns > 0;
        has_others.then(|| self.call_next(|it| it.turns == 0))?
    }

    /// Gives turns to waiters while there are free ones: to the user with the fewest turns, or of several
    /// to the one who has taken least. Returns the waiters, which must be woken.
    pub(super) fn call(&mut self) -> Vec<Arc<Waiter>> {
        let next = || {
            let is_free = self.turns < self.limit(self.users());
            is_free.then(|| self.call_next(|_| true))?
        };
        std::iter::from_fn(next).collect()
    }

    fn call_next(&mut self, is_admitted: impl Fn(&Account) -> bool) -> Option<Arc<Waiter>> {
        let waiting = self.accounts.values_mut();
        let waiting = waiting.filter(|it| !it.waiters.is_empty() && is_admitted(it));
        let account = waiting.min_by_key(|it| (it.turns, it.taken))?;
        let ((time, _), waiter) = account.waiters.pop_first()?;
        account.virtual_time = account.virtual_time.max(time);
        account.turns += 1;
        self.turns += 1;
        self.virtual_time = self.virtual_time.max(account.taken);
        waiter.is_called.store(true, Ordering::Release);
        Some(waiter)
    }

    /// Turns at once while swarms of so many users compute or wait.
    fn limit(&self, users: usize) -> usize {
        match users > 1 {
            true => self.max_shared,
            false => self.max_turns,
        }
    }

    /// Users whose swarms compute or wait.
    fn users(&self) -> usize {
        self.accounts
            .values()
            .filter(|it| it.is_computing())
            .count()
    }

    /// Users whose swarms compute or wait, counting this one.
    fn users_with(&mut self, owner: &Owner) -> usize {
        self.users() + usize::from(!self.account(owner).is_computing())
    }

    /// What a waiting or computing swarm of this user starts from: time that it did not use while others
    /// did is no credit.
    pub(super) fn raise(&mut self, owner: &Owner, virtual_time: Duration) -> Duration {
        let least = self.virtual_time;
        let account = self.account(owner);
        if !account.is_computing() {
            account.taken = account.taken.max(least);
        }
        account.virtual_time.max(virtual_time)
    }
}
