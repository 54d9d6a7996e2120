-- The place of a job among those of its priority: its age, unless it was moved. A moved job's place lies between those of
-- its neighbors; the ages are far apart.

ALTER TABLE job ADD COLUMN place INTEGER;

DROP INDEX job_by_share;
CREATE INDEX job_by_share ON job (submitter, priority, paused, (coalesce(place, number * 1048576)), number, nodes)
    WHERE finished_at_ms IS NULL;
CREATE INDEX job_by_place ON job (priority DESC, (coalesce(place, number * 1048576)), number)
    WHERE finished_at_ms IS NULL AND paused = 0;
