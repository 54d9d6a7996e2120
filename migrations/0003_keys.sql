-- Who may come in, what waits for whom, and who did what.
-- A key's secret is nowhere: only its SHA-256 is. Keys live and end by the wall clock.

CREATE TABLE key (
    number              INTEGER PRIMARY KEY AUTOINCREMENT,
    id                  TEXT NOT NULL UNIQUE,
    name                TEXT NOT NULL CHECK (length(name) BETWEEN 1 AND 64),
    digest              BLOB NOT NULL UNIQUE CHECK (length(digest) = 32),
    may_submit          INTEGER NOT NULL CHECK (may_submit IN (0, 1)),
    may_read            INTEGER NOT NULL CHECK (may_read IN (0, 1)),
    may_work            INTEGER NOT NULL CHECK (may_work IN (0, 1)),
    may_administer      INTEGER NOT NULL CHECK (may_administer IN (0, 1)),
    max_jobs            INTEGER CHECK (max_jobs > 0),
    max_rays            INTEGER CHECK (max_rays > 0),
    requests_per_second INTEGER CHECK (requests_per_second > 0),
    created_at_ms       INTEGER NOT NULL,
    expires_at_ms       INTEGER CHECK (expires_at_ms > created_at_ms),
    revoked_at_ms       INTEGER,
    last_used_at_ms     INTEGER,
    CHECK (may_submit + may_read + may_work + may_administer > 0)
) STRICT;

CREATE INDEX key_by_name ON key (name) WHERE revoked_at_ms IS NULL;

-- Who may not see every job lists those of its own name.
CREATE INDEX job_by_submitter ON job (submitter, number);

-- Unfinished jobs and their rays, of each submitter and (as '*', which no key is named) of all.
-- Kept by the triggers below, in whatever transaction changes a job.
CREATE TABLE backlog (
    submitter TEXT PRIMARY KEY,
    jobs      INTEGER NOT NULL CHECK (jobs >= 0),
    rays      INTEGER NOT NULL CHECK (rays >= 0)
) STRICT, WITHOUT ROWID;

INSERT INTO backlog (submitter, jobs, rays)
SELECT submitter, count(*), sum(rays_total) FROM job WHERE finished_at_ms IS NULL GROUP BY submitter
UNION ALL
SELECT '*', count(*), coalesce(sum(rays_total), 0) FROM job WHERE finished_at_ms IS NULL;

CREATE TRIGGER backlog_grows AFTER INSERT ON job WHEN new.finished_at_ms IS NULL BEGIN
    INSERT INTO backlog (submitter, jobs, rays)
    VALUES (new.submitter, 1, new.rays_total), ('*', 1, new.rays_total)
    ON CONFLICT (submitter) DO UPDATE SET jobs = jobs + 1, rays = rays + excluded.rays;
END;

CREATE TRIGGER backlog_grows_again AFTER UPDATE OF finished_at_ms ON job
WHEN old.finished_at_ms IS NOT NULL AND new.finished_at_ms IS NULL BEGIN
    INSERT INTO backlog (submitter, jobs, rays)
    VALUES (new.submitter, 1, new.rays_total), ('*', 1, new.rays_total)
    ON CONFLICT (submitter) DO UPDATE SET jobs = jobs + 1, rays = rays + excluded.rays;
END;

CREATE TRIGGER backlog_shrinks AFTER UPDATE OF finished_at_ms ON job
WHEN old.finished_at_ms IS NULL AND new.finished_at_ms IS NOT NULL BEGIN
    UPDATE backlog SET jobs = jobs - 1, rays = rays - new.rays_total WHERE submitter IN (new.submitter, '*');
    DELETE FROM backlog WHERE submitter = new.submitter AND jobs = 0;
END;

CREATE TRIGGER backlog_forgets AFTER DELETE ON job WHEN old.finished_at_ms IS NULL BEGIN
    UPDATE backlog SET jobs = jobs - 1, rays = rays - old.rays_total WHERE submitter IN (old.submitter, '*');
    DELETE FROM backlog WHERE submitter = old.submitter AND jobs = 0;
END;

-- Who did what: the newest entries only.
CREATE TABLE audit (
    number     INTEGER PRIMARY KEY AUTOINCREMENT,
    at_ms      INTEGER NOT NULL,
    who        TEXT NOT NULL,
    key        TEXT,
    address    TEXT NOT NULL,
    method     TEXT NOT NULL,
    route      TEXT NOT NULL,
    job        TEXT,
    status     INTEGER NOT NULL CHECK (status BETWEEN 100 AND 599),
    code       TEXT,
    request_id TEXT NOT NULL,
    times      INTEGER NOT NULL CHECK (times > 0)
) STRICT;
