-- Time limit for rendering a tile of the job, in seconds: above it, its worker stops and reports the tile as failed.
-- Jobs from before have the default of `sdfarm serve --max-tile-seconds`.

ALTER TABLE job ADD COLUMN tile_seconds INTEGER NOT NULL DEFAULT 600 CHECK (tile_seconds BETWEEN 1 AND 86400);
