-- Changes of jobs that are no events of theirs: of the priority or the pause, and deletions. Streams of all jobs have
-- them beside the outbox. A deleted job's row outlives the job, so it refers to none.

CREATE TABLE job_change (
    number    INTEGER PRIMARY KEY AUTOINCREMENT,
    job       INTEGER NOT NULL,
    id        TEXT NOT NULL,
    submitter TEXT NOT NULL,
    deleted   INTEGER NOT NULL CHECK (deleted IN (0, 1))
) STRICT;
