-- Which trace a job belongs to, of jobs that were handed in with one: a W3C traceparent. Written just before
-- the job itself, hence without a reference to it; what has no job is dropped with other rows that matter no more.

CREATE TABLE job_trace (
    job         TEXT PRIMARY KEY,
    traceparent TEXT NOT NULL CHECK (length(traceparent) BETWEEN 55 AND 512)
) STRICT, WITHOUT ROWID;
