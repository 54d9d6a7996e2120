-- The farm's throughput by minutes of the wall clock, for a week. Each server adds what its workers have rendered; the
-- counts of workers and jobs are those of the first server that writes the row.

CREATE TABLE minute (
    at_ms        INTEGER PRIMARY KEY,
    rays         INTEGER NOT NULL CHECK (rays >= 0),
    tiles        INTEGER NOT NULL CHECK (tiles >= 0),
    frames       INTEGER NOT NULL CHECK (frames >= 0),
    workers      INTEGER NOT NULL,
    busy         INTEGER NOT NULL,
    queued_tiles INTEGER NOT NULL,
    jobs_queued  INTEGER NOT NULL,
    jobs_running INTEGER NOT NULL
) STRICT;
