//! Rejections, counted by source: one entry for each source and period, however many requests were rejected.
//!
//! Both the number of entries and the number of lines in the log are bounded, so that rejected requests fill neither.

use std::collections::HashMap;
use std::sync::Mutex;

use db::Connection;

use super::{AuditRecord, insert};
use crate::db;
use crate::db::DatabaseError;

/// Period in which the rejections of a source share an entry.
const PERIOD_MS: i64 = 10 * 60_000;
/// Maximum number of sources of one address in a period; further ones are counted together.
const MAX_SOURCES_OF_ADDRESS: usize = 64;
/// Maximum number of sources in a period; sources of further addresses are counted together.
const MAX_SOURCES: usize = 1000;
/// Number of rejections of a source that are logged one by one in a period; later ones are logged as counts.
const MAX_LOGGED: u32 = 3;
/// Interval at which the count of a source is logged.
const LOG_INTERVAL_MS: i64 = 60_000;
/// In an entry: several addresses, callers, methods or routes, counted together.
const SEVERAL: &str = "*";

/// Rejections of the current period.
#[derive(Debug, Default)]
pub(super) struct Refusals(Mutex<Period>);

#[derive(Debug, Default)]
struct Period {
    begun_ms: i64,
    sources: HashMap<AuditRecord, Count>,
    sources_of_address: HashMap<String, usize>,
}

#[derive(Clone, Debug)]
struct Count {
    /// The first rejection.
    first: AuditRecord,
    /// Position among the sources of the period.
    position: usize,
    at_ms: i64,
    times: u32,
    written: u32,
    logged: u32,
    logged_at_ms: i64,
    number: Option<i64>,
}

/// Count that is to be written.
#[derive(Debug)]
pub(super) struct UnwrittenCount {
    /// When its period began.
    begun_ms: i64,
    source: AuditRecord,
    count: Count,
}

/// Entry of a count that was written.
#[derive(Debug)]
pub(super) struct WrittenCount {
    begun_ms: i64,
    source: AuditRecord,
    number: i64,
}

impl UnwrittenCount {
    /// Writes the entry.
    pub(super) async fn write(self, connection: &mut Connection) -> Result<WrittenCount, DatabaseError> {
        let Self { begun_ms, source, count } = self;
        let number = match count.number {
            None => insert(connection, &count.first, count.at_ms, count.times).await?,
            Some(number) => {
                db::query("UPDATE audit SET times = ? WHERE number = ?")
                    .bind(count.times)
                    .bind(number)
                    .execute(connection)
                    .await?;
                number
            }
        };
        Ok(WrittenCount { begun_ms, source, number })
    }
}

/// The source of a rejection: all of it, except what differs with each request.
fn source_of(refused: &AuditRecord) -> AuditRecord {
    AuditRecord { job: None, request_id: String::new(), ..refused.clone() }
}

impl Refusals {
    /// Counts a rejection; logs it if it is one of the first of its source.
    pub(super) fn count(&self, refused: AuditRecord, at_ms: i64) {
        if let Some(first) = self.0.lock().expect("no holder panics").count(refused, at_ms) {
            first.log(1, "refused");
        }
    }

    /// Counts that have changed since they were last written, oldest sources first; also logs counts that are due.
    pub(super) fn take_unwritten(&self, now_ms: i64) -> Vec<UnwrittenCount> {
        let mut period = self.0.lock().expect("no holder panics");
        let ends = now_ms >= period.begun_ms + PERIOD_MS;
        let begun_ms = period.begun_ms;
        let mut unwritten = Vec::new();
        for (source, count) in &mut period.sources {
            if count.times > count.logged && (ends || now_ms >= count.logged_at_ms + LOG_INTERVAL_MS) {
                count.first.log(count.times - count.logged, "refused again");
                (count.logged, count.logged_at_ms) = (count.times, now_ms);
            }
            if count.times > count.written {
                count.written = count.times;
                unwritten.push(UnwrittenCount { begun_ms, source: source.clone(), count: count.clone() });
            }
        }
        unwritten.sort_unstable_by_key(|refused| refused.count.position);
        if ends {
            *period = Period { begun_ms: now_ms, ..Period::default() };
        }
        unwritten
    }

    /// Sets the numbers of the entries that were written.
    pub(super) fn set_numbers(&self, written: Vec<WrittenCount>) {
        let mut period = self.0.lock().expect("no holder panics");
        for WrittenCount { begun_ms, source, number } in written {
            if begun_ms == period.begun_ms
                && let Some(count) = period.sources.get_mut(&source)
            {
                count.number = Some(number);
            }
        }
    }
}

impl Period {
    /// Counts a rejection; returns it if it is to be logged.
    fn count(&mut self, mut refused: AuditRecord, at_ms: i64) -> Option<AuditRecord> {
        let mut source = source_of(&refused);
        if !self.sources.contains_key(&source) {
            self.fold(&mut refused);
            source = source_of(&refused);
        }
        if let Some(count) = self.sources.get_mut(&source) {
            count.times = count.times.saturating_add(1);
            let is_logged = count.times <= MAX_LOGGED;
            count.logged += u32::from(is_logged);
            return is_logged.then_some(refused);
        }
        *self.sources_of_address.entry(refused.address.clone()).or_default() += 1;
        let count = Count {
            first: refused.clone(),
            position: self.sources.len(),
            at_ms,
            times: 1,
            written: 0,
            logged: 1,
            logged_at_ms: self.begun_ms,
            number: None,
        };
        self.sources.insert(source, count);
        Some(refused)
    }

    /// Counts a new source together with others, if there are too many.
    fn fold(&self, refused: &mut AuditRecord) {
        let of_address = self.sources_of_address.get(&refused.address).copied().unwrap_or(0);
        if self.sources.len() >= MAX_SOURCES {
            SEVERAL.clone_into(&mut refused.address);
        } else if of_address < MAX_SOURCES_OF_ADDRESS {
            return;
        }
        for several in [&mut refused.actor, &mut refused.method, &mut refused.route] {
            SEVERAL.clone_into(several);
        }
        refused.key = None;
    }
}
