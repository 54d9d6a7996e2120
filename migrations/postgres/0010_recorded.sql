-- Recorded jobs, and the records of their tiles: see migrations/0023_recorded.sql.

ALTER TABLE job ADD COLUMN recorded BIGINT NOT NULL DEFAULT 0 CHECK (recorded IN (0, 1));
ALTER TABLE job ADD COLUMN based_on TEXT CHECK (based_on IS NULL OR recorded = 1);
ALTER TABLE tile ADD COLUMN record TEXT CHECK (record IS NULL OR blob IS NOT NULL);
ALTER TABLE tile ADD COLUMN record_bytes BIGINT CHECK ((record_bytes IS NULL) = (record IS NULL));
ALTER TABLE tile ADD COLUMN kept BIGINT NOT NULL DEFAULT 0 CHECK (kept = 0 OR (kept = 1 AND record IS NOT NULL));

CREATE INDEX tile_by_record ON tile (record) WHERE record IS NOT NULL;
CREATE INDEX tile_kept ON tile (job) WHERE kept = 1;
