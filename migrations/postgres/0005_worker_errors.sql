-- Failed tiles of each worker: see migrations/0018_worker_errors.sql.

ALTER TABLE worker ADD COLUMN errors BIGINT NOT NULL DEFAULT 0 CHECK (errors >= 0);
ALTER TABLE worker ADD COLUMN last_error TEXT;
