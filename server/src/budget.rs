//! Budgets: an amount of something that callers share, such as bytes in memory or requests in progress.
//!
//! One holder never has more than its part, so that it cannot take the rest from the others.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Amount that callers share, up to a limit for all of them and one for each.
#[derive(Debug)]
pub(crate) struct Budget {
    limit: usize,
    holder_limit: usize,
    used: Mutex<Used>,
}

#[derive(Debug, Default)]
struct Used {
    total: usize,
    by_holder: HashMap<String, usize>,
}

/// Error returned when a budget is used up, with the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exhausted {
    /// The holder has its part.
    Holder(usize),
    /// All holders together have everything.
    Total(usize),
}

/// Part of a budget; it is returned when this is dropped.
#[derive(Debug)]
pub(crate) struct Share {
    budget: Arc<Budget>,
    holder: String,
    amount: usize,
}

impl Budget {
    /// Budget of `limit`; one holder may have `holder_limit` of it.
    pub(crate) fn new(limit: usize, holder_limit: usize) -> Arc<Self> {
        Arc::new(Self { limit, holder_limit: holder_limit.min(limit), used: Mutex::default() })
    }

    /// Takes a part for a holder.
    pub(crate) fn take(self: &Arc<Self>, holder: &str, amount: usize) -> Result<Share, Exhausted> {
        let mut share = self.empty(holder);
        share.grow(amount)?;
        Ok(share)
    }

    /// Part of a holder that has nothing yet.
    pub(crate) fn empty(self: &Arc<Self>, holder: &str) -> Share {
        Share { budget: Arc::clone(self), holder: holder.to_owned(), amount: 0 }
    }

    /// Amount that is taken.
    pub(crate) fn taken(&self) -> usize {
        self.used.lock().expect("no holder panics").total
    }

    fn add(&self, holder: &str, amount: usize) -> Result<(), Exhausted> {
        let mut used = self.used.lock().expect("no holder panics");
        let own = used.by_holder.get(holder).copied().unwrap_or(0);
        if amount > self.holder_limit.saturating_sub(own) {
            return Err(Exhausted::Holder(self.holder_limit));
        }
        if amount > self.limit.saturating_sub(used.total) {
            return Err(Exhausted::Total(self.limit));
        }
        used.total += amount;
        match used.by_holder.get_mut(holder) {
            Some(own) => *own += amount,
            None => drop(used.by_holder.insert(holder.to_owned(), amount)),
        }
        Ok(())
    }
}

impl Share {
    /// Takes more for the same holder.
    pub(crate) fn grow(&mut self, amount: usize) -> Result<(), Exhausted> {
        if amount == 0 {
            return Ok(());
        }
        self.budget.add(&self.holder, amount)?;
        self.amount += amount;
        Ok(())
    }

    /// Returns everything.
    pub(crate) fn clear(&mut self) {
        let amount = std::mem::take(&mut self.amount);
        if amount == 0 {
            return;
        }
        let mut used = self.budget.used.lock().expect("no holder panics");
        used.total -= amount;
        if let Some(own) = used.by_holder.get_mut(&self.holder) {
            *own -= amount;
            if *own == 0 {
                used.by_holder.remove(&self.holder);
            }
        }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_holder_never_takes_the_part_of_others() {
        let budget = Budget::new(10, 4);
        let mut anna = budget.take("anna", 3).expect("within both limits");
        assert_eq!(anna.grow(2).expect_err("above 4"), Exhausted::Holder(4));
        anna.grow(1).expect("exactly 4");
        assert_eq!(budget.take("anna", 1).expect_err("above 4"), Exhausted::Holder(4));
        let others = [budget.take("bert", 4).expect("its part"), budget.take("carl", 2).expect("the rest")];
        assert_eq!(budget.take("dora", 1).expect_err("above 10"), Exhausted::Total(10));
        drop(others);
        assert_eq!(budget.taken(), 4);
        let dora = budget.take("dora", 4).expect("returned by others");
        drop((anna, dora));
        let used = budget.used.lock().expect("no holder panics");
        assert!(used.total == 0 && used.by_holder.is_empty(), "{used:?}");
    }
}
