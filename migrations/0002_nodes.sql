-- What a job's scene asks of a worker: its nodes. 0 is not known, of jobs that were there before: any worker may try.

ALTER TABLE job ADD COLUMN nodes INTEGER NOT NULL DEFAULT 0 CHECK (nodes >= 0);

-- A worker of small scenes passes over the large ones without reading their rows.
DROP INDEX job_by_turn;
CREATE INDEX job_by_turn ON job (priority DESC, number, nodes) WHERE finished_at_ms IS NULL;

-- Any worker stitches.
CREATE INDEX tile_stitch ON tile (job) WHERE state = 'ready' AND kind = 'stitch';
