-- The maker of each tile, kept as long as the tile: leases are deleted an hour after they were granted, and workers with
-- their last lease. A maker is a worker of which a tile is left.

CREATE TABLE maker (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    worker TEXT NOT NULL UNIQUE,
    name   TEXT NOT NULL,
    device TEXT NOT NULL
) STRICT;

-- The last lease with a result, by the wall clock.
CREATE TABLE tile_maker (
    tile        INTEGER PRIMARY KEY REFERENCES tile (id) ON DELETE CASCADE,
    maker       INTEGER NOT NULL REFERENCES maker (number),
    ended_at_ms INTEGER NOT NULL,
    took_ms     INTEGER NOT NULL CHECK (took_ms >= 0),
    used_us     INTEGER
) STRICT;

CREATE INDEX tile_maker_by_maker ON tile_maker (maker);
