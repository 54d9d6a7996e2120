-- Several servers on one PostgreSQL database. On SQLite a farm has one server; the tables are the same, so that a farm
-- can be moved.

-- Servers that run, or ran until a moment ago. Each renews seen_ms; one that does not has ended, and what its pool's
-- workers held is ready again. Workers of a pool have their server's generation.
CREATE TABLE server (
    generation    INTEGER PRIMARY KEY,
    name          TEXT NOT NULL UNIQUE,
    started_at_ms INTEGER NOT NULL,
    seen_ms       INTEGER NOT NULL
) STRICT;

-- Added to the time of the database's clock, so that leases do not notice when that clock jumps.
INSERT INTO meta (name, value) VALUES ('clock_offset_ms', 0);

-- The server that makes an attempt has until then to record its outcome; then another may try.
ALTER TABLE delivery ADD COLUMN claimed_until_ms INTEGER;

-- Numbers of events that a restored database skips, because clients may have got other events under them. Numbers after
-- after_number, and before next_number, are not of this database.
CREATE TABLE event_gap (
    after_number INTEGER PRIMARY KEY,
    next_number  INTEGER NOT NULL CHECK (next_number > after_number)
) STRICT;
