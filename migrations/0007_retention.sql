-- How long a finished job is kept: its own word in milliseconds, -1 for ever, null as the server was told.

ALTER TABLE job ADD COLUMN keep_ms INTEGER CHECK (keep_ms >= -1);

-- Jobs that have a time of their own, by when it is over.
CREATE INDEX job_by_own_end ON job (finished_at_ms + keep_ms)
    WHERE finished_at_ms IS NOT NULL AND keep_ms >= 0;

-- Jobs kept as the server was told, by when they finished.
CREATE INDEX job_by_finish ON job (finished_at_ms) WHERE finished_at_ms IS NOT NULL AND keep_ms IS NULL;

-- Jobs that a full store may lose, by when they finished.
CREATE INDEX job_not_for_ever ON job (finished_at_ms)
    WHERE finished_at_ms IS NOT NULL AND (keep_ms IS NULL OR keep_ms >= 0);
