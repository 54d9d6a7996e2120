-- Fair share between submitters, pauses, how long tiles take, and workers that fail in a job.

ALTER TABLE job ADD COLUMN paused INTEGER NOT NULL DEFAULT 0 CHECK (paused IN (0, 1));

INSERT INTO meta (name, value) VALUES ('paused', 0);

-- What each submitter has been served among jobs of one priority, in microseconds of a worker: the least served
-- is next. Only those with jobs that may be leased take part.
CREATE TABLE share (
    submitter TEXT NOT NULL,
    priority  INTEGER NOT NULL CHECK (priority BETWEEN -100 AND 100),
    jobs      INTEGER NOT NULL CHECK (jobs >= 0),
    served_us INTEGER NOT NULL CHECK (served_us >= 0),
    PRIMARY KEY (submitter, priority)
) STRICT, WITHOUT ROWID;

CREATE UNIQUE INDEX share_by_turn ON share (priority DESC, served_us, submitter) WHERE jobs > 0;

-- Where the submitter stood that was served last: one that comes back starts from here, without old credit.
CREATE TABLE share_clock (
    priority  INTEGER PRIMARY KEY CHECK (priority BETWEEN -100 AND 100),
    served_us INTEGER NOT NULL CHECK (served_us >= 0)
) STRICT;

INSERT INTO share (submitter, priority, jobs, served_us)
SELECT submitter, priority, count(*), 0 FROM job WHERE finished_at_ms IS NULL GROUP BY submitter, priority;

-- The order of jobs within a share; a worker of small scenes passes over the large ones without reading their rows.
DROP INDEX job_by_turn;
CREATE INDEX job_by_share ON job (submitter, priority, paused, number, nodes) WHERE finished_at_ms IS NULL;

-- How long the last deliveries of a job took, from lease to result; the oldest slot is written over.
CREATE TABLE pace (
    job     INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    slot    INTEGER NOT NULL CHECK (slot >= 0),
    took_ms INTEGER NOT NULL CHECK (took_ms >= 0),
    PRIMARY KEY (job, slot)
) STRICT, WITHOUT ROWID;

CREATE INDEX pace_by_time ON pace (job, took_ms);

-- Errors of one worker in one job; from the third on it is not offered the job for a while.
CREATE TABLE strike (
    job      INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    worker   TEXT NOT NULL REFERENCES worker (id) ON DELETE CASCADE,
    errors   INTEGER NOT NULL CHECK (errors > 0),
    until_ms INTEGER,
    PRIMARY KEY (job, worker)
) STRICT, WITHOUT ROWID;

CREATE INDEX strike_by_worker ON strike (worker);

CREATE INDEX lease_live_by_grant ON lease (granted_ms) WHERE ended IS NULL;

CREATE TRIGGER job_takes_part AFTER INSERT ON job WHEN new.finished_at_ms IS NULL AND new.paused = 0 BEGIN
    INSERT INTO share (submitter, priority, jobs, served_us)
    VALUES (new.submitter, new.priority, 1,
            coalesce((SELECT served_us FROM share_clock WHERE priority = new.priority), 0))
    ON CONFLICT (submitter, priority) DO UPDATE SET
        jobs = jobs + 1, served_us = iif(jobs = 0, max(served_us, excluded.served_us), served_us);
END;

CREATE TRIGGER job_changes_part AFTER UPDATE OF submitter, priority, paused, finished_at_ms ON job BEGIN
    UPDATE share SET jobs = jobs - 1
    WHERE submitter = old.submitter AND priority = old.priority AND old.finished_at_ms IS NULL AND old.paused = 0;
    INSERT INTO share (submitter, priority, jobs, served_us)
    SELECT new.submitter, new.priority, 1,
           coalesce((SELECT served_us FROM share_clock WHERE priority = new.priority), 0)
    WHERE new.finished_at_ms IS NULL AND new.paused = 0
    ON CONFLICT (submitter, priority) DO UPDATE SET
        jobs = jobs + 1, served_us = iif(jobs = 0, max(served_us, excluded.served_us), served_us);
    DELETE FROM pace WHERE job = new.number AND new.finished_at_ms IS NOT NULL;
    -- What failed, failed on every worker: if it is tried again, each may try again.
    DELETE FROM strike WHERE job = new.number AND new.state = 'failed';
END;

CREATE TRIGGER job_takes_no_part AFTER DELETE ON job WHEN old.finished_at_ms IS NULL AND old.paused = 0 BEGIN
    UPDATE share SET jobs = jobs - 1 WHERE submitter = old.submitter AND priority = old.priority;
END;
