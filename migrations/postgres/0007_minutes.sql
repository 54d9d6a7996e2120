-- The farm's throughput by minutes: see migrations/0020_minutes.sql.

CREATE TABLE minute (
    at_ms        BIGINT PRIMARY KEY,
    rays         BIGINT NOT NULL CHECK (rays >= 0),
    tiles        BIGINT NOT NULL CHECK (tiles >= 0),
    frames       BIGINT NOT NULL CHECK (frames >= 0),
    workers      BIGINT NOT NULL,
    busy         BIGINT NOT NULL,
    queued_tiles BIGINT NOT NULL,
    jobs_queued  BIGINT NOT NULL,
    jobs_running BIGINT NOT NULL
);
