-- Books that no number from outside can break: speeds and shares have bounds, a charge is corrected by the time
-- that was used, speeds are kept for each job, and large changes of a job are made in pieces.

-- Speeds are reported with every sync, so the old ones are dropped, absurd ones with them.
ALTER TABLE worker DROP COLUMN rays_per_second;
ALTER TABLE worker ADD COLUMN rays_per_second REAL CHECK (rays_per_second BETWEEN 1.0 AND 1e15);
-- Time of the worker's last delivery, by the server's clock.
ALTER TABLE worker ADD COLUMN delivered_ms INTEGER NOT NULL DEFAULT 0 CHECK (delivered_ms >= 0);

-- Shares start again from zero. They only decide who is next, and one of them may be absurd. The maximum leaves
-- room for the largest charge to be added without overflow.
DROP TABLE share;
DROP TABLE share_clock;

CREATE TABLE share (
    submitter TEXT NOT NULL,
    priority  INTEGER NOT NULL CHECK (priority BETWEEN -100 AND 100),
    jobs      INTEGER NOT NULL CHECK (jobs >= 0),
    served_us INTEGER NOT NULL CHECK (served_us BETWEEN 0 AND 4611686018427387904),
    PRIMARY KEY (submitter, priority)
) STRICT, WITHOUT ROWID;

CREATE UNIQUE INDEX share_by_turn ON share (priority DESC, served_us, submitter) WHERE jobs > 0;

CREATE TABLE share_clock (
    priority  INTEGER PRIMARY KEY CHECK (priority BETWEEN -100 AND 100),
    served_us INTEGER NOT NULL CHECK (served_us BETWEEN 0 AND 4611686018427387904)
) STRICT;

INSERT INTO share (submitter, priority, jobs, served_us)
SELECT submitter, priority, count(*), 0 FROM job WHERE finished_at_ms IS NULL AND paused = 0
GROUP BY submitter, priority;

-- What the lease was charged for, to the share of this priority, and the time that was really used, once it is
-- known.
ALTER TABLE lease ADD COLUMN charged_us INTEGER NOT NULL DEFAULT 0 CHECK (charged_us BETWEEN 0 AND 3600000000);
ALTER TABLE lease ADD COLUMN charged_priority INTEGER NOT NULL DEFAULT 0;
ALTER TABLE lease ADD COLUMN used_us INTEGER CHECK (used_us BETWEEN 0 AND 3600000000);

CREATE TRIGGER charge_corrected AFTER UPDATE OF ended ON lease
WHEN old.ended IS NULL AND new.ended IS NOT NULL AND new.used_us <> new.charged_us BEGIN
    UPDATE share SET served_us = max(0, min(4611686018427387904, served_us + new.used_us - new.charged_us))
    WHERE priority = new.charged_priority
      AND submitter = (SELECT job.submitter FROM tile CROSS JOIN job ON job.number = tile.job WHERE tile.id = new.tile);
END;

-- Speed of a worker in one job, from its latest deliveries.
CREATE TABLE speed (
    job     INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    worker  TEXT NOT NULL REFERENCES worker (id) ON DELETE CASCADE,
    rays    REAL NOT NULL CHECK (rays BETWEEN 0.0 AND 1e18),
    seconds REAL NOT NULL CHECK (seconds BETWEEN 0.0 AND 1e6),
    at_ms   INTEGER NOT NULL CHECK (at_ms >= 0),
    PRIMARY KEY (job, worker)
) STRICT, WITHOUT ROWID;

CREATE INDEX speed_by_worker ON speed (worker);

CREATE TRIGGER job_forgets_speeds AFTER UPDATE OF finished_at_ms ON job WHEN new.finished_at_ms IS NOT NULL BEGIN
    DELETE FROM speed WHERE job = new.number;
END;

-- A change that is made in pieces, and not finished yet: 'void' of open frames and tiles, 'requeue' of void and dead
-- ones, 'delete' of everything. A job that is being deleted is hidden, and its id is not a job's id any more.
ALTER TABLE job ADD COLUMN cleanup TEXT CHECK (cleanup IN ('void', 'requeue', 'delete'));

CREATE INDEX job_to_clean_up ON job (number) WHERE cleanup IS NOT NULL;
CREATE INDEX frame_unfinished ON frame (job, number) WHERE state IN ('open', 'stitching');
CREATE INDEX frame_void ON frame (job, number) WHERE state = 'void';
