-- What workers deliver is checked, and a share of what remote workers deliver is rendered again by another worker.

-- Results of this worker that were not what was asked for.
ALTER TABLE worker ADD COLUMN wrong_results INTEGER NOT NULL DEFAULT 0 CHECK (wrong_results >= 0);
-- When it registered, by the server's own clock.
ALTER TABLE worker ADD COLUMN registered_ms INTEGER NOT NULL DEFAULT 0;
-- Newest lease whose result another worker confirmed.
ALTER TABLE worker ADD COLUMN verified_lease TEXT;

-- A result that another worker is to confirm: a tile's blob, or (position -1) the picture of a frame that was
-- stitched, or (position -2) that of a frame that was rendered as a whole.
CREATE TABLE verification (
    number        INTEGER PRIMARY KEY,
    job           INTEGER NOT NULL,
    frame         INTEGER NOT NULL,
    position      INTEGER NOT NULL CHECK (position >= -2),
    worker        TEXT NOT NULL REFERENCES worker (id) ON DELETE CASCADE,
    lease         TEXT NOT NULL,
    hash          TEXT NOT NULL,
    -- Who confirmed it not; then a third worker decides.
    second_worker TEXT,
    second_hash   TEXT,
    -- Who renders it again now.
    verifier      TEXT,
    granted_ms    INTEGER,
    expires_ms    INTEGER,
    created_ms    INTEGER NOT NULL,
    FOREIGN KEY (job, frame) REFERENCES frame (job, number) ON DELETE CASCADE,
    UNIQUE (job, frame, position),
    CHECK ((second_worker IS NULL) = (second_hash IS NULL)),
    CHECK ((verifier IS NULL) = (granted_ms IS NULL)),
    CHECK ((verifier IS NULL) = (expires_ms IS NULL))
) STRICT;

CREATE INDEX verification_by_verifier ON verification (verifier) WHERE verifier IS NOT NULL;
CREATE INDEX verification_by_worker ON verification (worker);

-- Leases of verifications: one, or that of each tile of a whole frame.
CREATE TABLE verification_lease (
    id           TEXT PRIMARY KEY,
    verification INTEGER NOT NULL REFERENCES verification (number) ON DELETE CASCADE,
    position     INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE INDEX verification_lease_by_verification ON verification_lease (verification);
