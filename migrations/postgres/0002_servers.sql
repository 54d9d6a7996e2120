-- Several servers on one database: see migrations/0015_servers.sql.

CREATE TABLE server (
    generation    BIGINT PRIMARY KEY,
    name          TEXT NOT NULL UNIQUE,
    started_at_ms BIGINT NOT NULL,
    seen_ms       BIGINT NOT NULL
) WITH (fillfactor = 50);

INSERT INTO meta (name, value) VALUES ('clock_offset_ms', 0);

ALTER TABLE delivery ADD COLUMN claimed_until_ms BIGINT;

CREATE TABLE event_gap (
    after_number BIGINT PRIMARY KEY,
    next_number  BIGINT NOT NULL CHECK (next_number > after_number)
);
