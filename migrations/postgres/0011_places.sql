-- Places of jobs in the queue: see migrations/0024_places.sql.

ALTER TABLE job ADD COLUMN place BIGINT;

DROP INDEX job_by_share;
CREATE INDEX job_by_share ON job (submitter, priority, paused, (coalesce(place, number * 1048576)), number, nodes)
    WHERE finished_at_ms IS NULL;
CREATE INDEX job_by_place ON job (priority DESC, (coalesce(place, number * 1048576)), number)
    WHERE finished_at_ms IS NULL AND paused = 0;
