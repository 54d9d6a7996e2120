-- What happens to a job, for those who follow it and for those who want to be told: states, progress by
-- hundredths, tiles, frames. Written by triggers, so that it commits with the change itself.

ALTER TABLE job ADD COLUMN retried_at_ms INTEGER;
-- Events up to this number are kept no longer.
ALTER TABLE job ADD COLUMN events_pruned INTEGER NOT NULL DEFAULT 0 CHECK (events_pruned >= 0);
-- 0: the job had ended, and its events were dropped.
ALTER TABLE job ADD COLUMN events_kept INTEGER NOT NULL DEFAULT 1 CHECK (events_kept IN (0, 1));

CREATE INDEX job_with_old_events ON job (finished_at_ms) WHERE events_kept = 1 AND finished_at_ms IS NOT NULL;

DROP TRIGGER job_accepted;
DROP TRIGGER job_moved;
ALTER TABLE outbox RENAME TO outbox_before;
DROP INDEX outbox_by_job;

-- The body is what is told, as JSON; a state is also in its column, for those who act on it.
CREATE TABLE outbox (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    job    INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    kind   TEXT NOT NULL CHECK (kind IN ('state', 'progress', 'tile', 'frame')),
    state  TEXT CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    body   TEXT NOT NULL,
    CHECK ((state IS NOT NULL) = (kind = 'state'))
) STRICT;

CREATE INDEX outbox_by_job ON outbox (job);

INSERT INTO outbox (number, job, kind, state, body)
SELECT number, job, 'state', state,
       json_object('state', state, 'errors', json_array(), 'at', strftime('%Y-%m-%dT%H:%M:%fZ', at_ms / 1000.0, 'unixepoch'))
FROM outbox_before ORDER BY number;

DROP TABLE outbox_before;

-- Of jobs that were there before, tiles and frames were not told.
UPDATE job SET events_pruned = (SELECT coalesce(max(number), 0) FROM outbox);

CREATE TRIGGER job_accepted AFTER INSERT ON job BEGIN
    INSERT INTO outbox (job, kind, state, body)
    VALUES (new.number, 'state', new.state,
            json_object('state', new.state, 'errors', json_array(),
                        'at', strftime('%Y-%m-%dT%H:%M:%fZ', new.created_at_ms / 1000.0, 'unixepoch')));
END;

CREATE TRIGGER job_moved AFTER UPDATE OF state ON job WHEN new.state <> old.state BEGIN
    INSERT INTO outbox (job, kind, state, body)
    VALUES (new.number, 'state', new.state,
            json_object('state', new.state,
                        'errors', iif(new.error IS NULL, json_array(), json_array(new.error)),
                        'at', strftime('%Y-%m-%dT%H:%M:%fZ',
                                       coalesce(new.finished_at_ms, new.retried_at_ms, new.started_at_ms,
                                                new.created_at_ms) / 1000.0, 'unixepoch')));
END;

CREATE TRIGGER job_progressed AFTER UPDATE OF rays_peak ON job
WHEN CAST(new.rays_peak * 100.0 / new.rays_total AS INTEGER) <> CAST(old.rays_peak * 100.0 / old.rays_total AS INTEGER)
BEGIN
    INSERT INTO outbox (job, kind, body)
    VALUES (new.number, 'progress',
            json_object('progress', new.rays_peak * 1.0 / new.rays_total,
                        'tiles', json_object('done', new.tiles_done, 'total', new.tiles_total)));
END;

CREATE TRIGGER tile_rendered AFTER UPDATE OF state ON tile
WHEN new.kind = 'render' AND (new.state = 'done') <> (old.state = 'done')
BEGIN
    INSERT INTO outbox (job, kind, body)
    VALUES (new.job, 'tile',
            json_object('frame', new.frame, 'x', new.x_px, 'y', new.y_px, 'width', new.width_px,
                        'height', new.height_px, 'done', json(iif(new.state = 'done', 'true', 'false'))));
END;

CREATE TRIGGER frame_stored AFTER UPDATE OF state ON frame WHEN new.state = 'stored' BEGIN
    INSERT INTO outbox (job, kind, body)
    SELECT new.job, 'frame',
           json_object('frame', new.number, 'picture', new.picture, 'size_bytes', new.size_bytes,
                       'image', '/v1/jobs/' || id || '/frames/' || new.number || '/image')
    FROM job WHERE number = new.job;
END;

CREATE TRIGGER frame_reused AFTER INSERT ON frame WHEN new.state = 'stored' BEGIN
    INSERT INTO outbox (job, kind, body)
    SELECT new.job, 'frame',
           json_object('frame', new.number, 'picture', new.picture, 'size_bytes', new.size_bytes,
                       'image', '/v1/jobs/' || id || '/frames/' || new.number || '/image')
    FROM job WHERE number = new.job;
END;

-- A wish that came with an Idempotency-Key, and the job that was made of it.
CREATE TABLE idempotency (
    submitter     TEXT NOT NULL,
    key           TEXT NOT NULL,
    fingerprint   TEXT NOT NULL,
    job           INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    created_at_ms INTEGER NOT NULL,
    PRIMARY KEY (submitter, key)
) STRICT, WITHOUT ROWID;

CREATE INDEX idempotency_by_job ON idempotency (job);
CREATE INDEX idempotency_by_age ON idempotency (created_at_ms);
