-- The farm: jobs, their frames and tiles, the leases on tiles, the workers, the stored pictures.
-- Times named *_at_ms are wall clock, for people; every other *_ms is the server's own clock,
-- which starts at 0 with each boot, so that a jump of the wall clock expires nothing.

CREATE TABLE meta (
    name  TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

INSERT INTO meta (name, value) VALUES ('boot_generation', 0);

CREATE TABLE job (
    number         INTEGER PRIMARY KEY AUTOINCREMENT,
    id             TEXT NOT NULL UNIQUE,
    name           TEXT NOT NULL,
    submitter      TEXT NOT NULL,
    priority       INTEGER NOT NULL CHECK (priority BETWEEN -100 AND 100),
    state          TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    fresh          INTEGER NOT NULL CHECK (fresh IN (0, 1)),
    width_px       INTEGER NOT NULL CHECK (width_px > 0),
    height_px      INTEGER NOT NULL CHECK (height_px > 0),
    samples        INTEGER NOT NULL CHECK (samples > 0),
    pixel_bytes    INTEGER NOT NULL CHECK (pixel_bytes > 0),
    edge_px        INTEGER CHECK (edge_px > 0),
    media_type     TEXT NOT NULL,
    frames_total   INTEGER NOT NULL CHECK (frames_total > 0),
    frames_opened  INTEGER NOT NULL DEFAULT 0 CHECK (frames_opened BETWEEN 0 AND frames_total),
    frames_stored  INTEGER NOT NULL DEFAULT 0 CHECK (frames_stored BETWEEN 0 AND frames_opened),
    tiles_total    INTEGER NOT NULL CHECK (tiles_total >= frames_total),
    tiles_done     INTEGER NOT NULL DEFAULT 0 CHECK (tiles_done BETWEEN 0 AND tiles_total),
    tiles_dead     INTEGER NOT NULL DEFAULT 0 CHECK (tiles_dead >= 0),
    rays_total     INTEGER NOT NULL CHECK (rays_total > 0),
    rays_done      INTEGER NOT NULL DEFAULT 0 CHECK (rays_done BETWEEN 0 AND rays_total),
    rays_peak      INTEGER NOT NULL DEFAULT 0 CHECK (rays_peak BETWEEN rays_done AND rays_total),
    warnings       TEXT NOT NULL,
    error          TEXT,
    created_at_ms  INTEGER NOT NULL,
    started_at_ms  INTEGER,
    finished_at_ms INTEGER,
    CHECK ((finished_at_ms IS NOT NULL) = (state IN ('succeeded', 'failed', 'cancelled'))),
    CHECK (state <> 'succeeded' OR frames_stored = frames_total),
    CHECK ((error IS NOT NULL) = (state = 'failed'))
) STRICT;

CREATE INDEX job_by_turn ON job (priority DESC, number) WHERE finished_at_ms IS NULL;
CREATE INDEX job_by_state ON job (state, number);

-- The file as it was posted; apart, so that a job's row stays small.
CREATE TABLE job_file (
    job  INTEGER PRIMARY KEY REFERENCES job (number) ON DELETE CASCADE,
    text TEXT NOT NULL
) STRICT;

CREATE TABLE frame (
    job         INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    number      INTEGER NOT NULL CHECK (number >= 0),
    state       TEXT NOT NULL CHECK (state IN ('open', 'stitching', 'stored', 'void')),
    picture_key TEXT NOT NULL,
    tiles_total INTEGER NOT NULL CHECK (tiles_total > 0),
    tiles_done  INTEGER NOT NULL DEFAULT 0 CHECK (tiles_done BETWEEN 0 AND tiles_total),
    picture     TEXT,
    size_bytes  INTEGER,
    PRIMARY KEY (job, number),
    CHECK ((picture IS NOT NULL) = (state = 'stored')),
    CHECK ((size_bytes IS NOT NULL) = (state = 'stored')),
    CHECK (state NOT IN ('stitching', 'stored') OR tiles_done = tiles_total)
) STRICT, WITHOUT ROWID;

CREATE INDEX frame_by_picture ON frame (picture) WHERE picture IS NOT NULL;

-- A rectangle to render, or (kind 'stitch', position -1) the frame's picture to make from its blobs.
CREATE TABLE tile (
    id            INTEGER PRIMARY KEY,
    job           INTEGER NOT NULL,
    frame         INTEGER NOT NULL,
    kind          TEXT NOT NULL CHECK (kind IN ('render', 'stitch')),
    position      INTEGER NOT NULL,
    x_px          INTEGER NOT NULL,
    y_px          INTEGER NOT NULL,
    width_px      INTEGER NOT NULL CHECK (width_px > 0),
    height_px     INTEGER NOT NULL CHECK (height_px > 0),
    rays          INTEGER NOT NULL CHECK (rays >= 0),
    state         TEXT NOT NULL CHECK (state IN ('ready', 'leased', 'done', 'dead', 'void')),
    not_before_ms INTEGER NOT NULL DEFAULT 0,
    avoid         TEXT,
    errors        INTEGER NOT NULL DEFAULT 0,
    crashes       INTEGER NOT NULL DEFAULT 0,
    lost          INTEGER NOT NULL DEFAULT 0,
    interrupts    INTEGER NOT NULL DEFAULT 0,
    epoch         INTEGER NOT NULL DEFAULT 0,
    blob          TEXT,
    blob_bytes    INTEGER,
    FOREIGN KEY (job, frame) REFERENCES frame (job, number) ON DELETE CASCADE,
    UNIQUE (job, frame, position),
    CHECK ((kind = 'stitch') = (position = -1)),
    CHECK (blob IS NULL OR (state IN ('done', 'void') AND kind = 'render')),
    CHECK ((blob IS NULL) = (blob_bytes IS NULL))
) STRICT;

CREATE INDEX tile_ready ON tile (job, frame, position) WHERE state = 'ready';
CREATE INDEX tile_waiting ON tile (not_before_ms) WHERE state = 'ready' AND not_before_ms > 0;
CREATE INDEX tile_by_blob ON tile (blob) WHERE blob IS NOT NULL;

CREATE TABLE worker (
    id              TEXT PRIMARY KEY,
    name            TEXT NOT NULL,
    device          TEXT NOT NULL,
    state           TEXT NOT NULL CHECK (state IN ('starting', 'ready', 'draining', 'gone', 'quarantined')),
    pool            INTEGER NOT NULL CHECK (pool IN (0, 1)),
    process         INTEGER NOT NULL,
    max_nodes       INTEGER,
    rays_per_second REAL,
    generation      INTEGER NOT NULL,
    seen_ms         INTEGER NOT NULL
) STRICT;

CREATE INDEX worker_present ON worker (seen_ms) WHERE state <> 'gone';

CREATE TABLE lease (
    id         TEXT PRIMARY KEY,
    tile       INTEGER NOT NULL REFERENCES tile (id) ON DELETE CASCADE,
    epoch      INTEGER NOT NULL,
    worker     TEXT NOT NULL REFERENCES worker (id),
    generation INTEGER NOT NULL,
    granted_ms INTEGER NOT NULL,
    expires_ms INTEGER NOT NULL,
    ended      TEXT CHECK (ended IN ('done', 'failed', 'crashed', 'lost', 'interrupted', 'void')),
    UNIQUE (tile, epoch)
) STRICT, WITHOUT ROWID;

CREATE INDEX lease_live_by_expiry ON lease (expires_ms) WHERE ended IS NULL;
CREATE INDEX lease_live_by_worker ON lease (worker) WHERE ended IS NULL;
CREATE INDEX lease_live_by_tile ON lease (tile) WHERE ended IS NULL;
CREATE INDEX lease_by_worker ON lease (worker);

-- Pictures that may be shown again, by what they are of.
CREATE TABLE picture (
    key        TEXT PRIMARY KEY,
    hash       TEXT NOT NULL,
    size_bytes INTEGER NOT NULL,
    media_type TEXT NOT NULL,
    stored_at_ms INTEGER NOT NULL
) STRICT;

CREATE INDEX picture_by_hash ON picture (hash);

-- What happened to jobs, for those who want to be told; written with the change itself.
CREATE TABLE outbox (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    job    INTEGER NOT NULL REFERENCES job (number) ON DELETE CASCADE,
    state  TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    at_ms  INTEGER NOT NULL
) STRICT;

CREATE INDEX outbox_by_job ON outbox (job);

CREATE TRIGGER job_accepted AFTER INSERT ON job BEGIN
    INSERT INTO outbox (job, state, at_ms) VALUES (new.number, new.state, new.created_at_ms);
END;

CREATE TRIGGER job_moved AFTER UPDATE OF state ON job WHEN new.state <> old.state BEGIN
    INSERT INTO outbox (job, state, at_ms)
    VALUES (new.number, new.state, coalesce(new.finished_at_ms, new.started_at_ms, new.created_at_ms));
END;
