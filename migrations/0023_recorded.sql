-- Recorded jobs: their tiles keep their blobs, with a record of what each tile's rays asked for, as long as the job. A job
-- that is based on one keeps the pixels of tiles that the differences of the two can't reach.

ALTER TABLE job ADD COLUMN recorded INTEGER NOT NULL DEFAULT 0 CHECK (recorded IN (0, 1));
ALTER TABLE job ADD COLUMN based_on TEXT CHECK (based_on IS NULL OR recorded = 1);
ALTER TABLE tile ADD COLUMN record TEXT CHECK (record IS NULL OR blob IS NOT NULL);
ALTER TABLE tile ADD COLUMN record_bytes INTEGER CHECK ((record_bytes IS NULL) = (record IS NULL));
ALTER TABLE tile ADD COLUMN kept INTEGER NOT NULL DEFAULT 0 CHECK (kept = 0 OR (kept = 1 AND record IS NOT NULL));

CREATE INDEX tile_by_record ON tile (record) WHERE record IS NOT NULL;
CREATE INDEX tile_kept ON tile (job) WHERE kept = 1;
