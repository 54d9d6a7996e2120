SELECT number, id, width_px, height_px, samples, pixel_bytes, edge_px, frames_total, frames_opened, nodes, tile_seconds,
       recorded, based_on, state = 'queued' AS queued, job.submitter, job.priority
 FROM share @join job ON job.number = (
     SELECT number FROM job
     WHERE job.submitter = share.submitter AND job.priority = share.priority AND finished_at_ms IS NULL AND paused = 0
       AND (nodes <= ?4 OR number IN (SELECT stitch.job FROM tile AS stitch
            WHERE stitch.state = 'ready' AND stitch.kind = 'stitch' AND stitch.not_before_ms <= ?1
              AND (stitch.avoid IS NULL OR stitch.avoid <> ?2 OR ?3 < 0)))
       AND (frames_opened < frames_total AND number NOT IN (SELECT value FROM @numbers(?6))
                AND share.submitter NOT IN (SELECT value FROM @texts(?7)) OR EXISTS (
            SELECT 1 FROM tile WHERE tile.job = job.number AND tile.state = 'ready' AND tile.not_before_ms <= ?1
              AND (tile.avoid IS NULL OR tile.avoid <> ?2
                   OR CASE WHEN tile.kind = 'stitch' THEN 0 ELSE job.nodes END > ?3)))
       AND NOT (EXISTS (SELECT 1 FROM strike WHERE strike.job = job.number AND strike.worker = ?2 AND until_ms > ?1)
            AND EXISTS (SELECT 1 FROM worker AS other
                WHERE other.state <> 'gone' AND other.state = 'ready' AND other.id <> ?2
                  AND coalesce(other.max_nodes, job.nodes) >= job.nodes
                  AND NOT EXISTS (SELECT 1 FROM strike
                      WHERE strike.job = job.number AND strike.worker = other.id AND until_ms > ?1)))
     ORDER BY coalesce(place, number * 1048576), number LIMIT 1)
 WHERE share.jobs > 0
   AND (?5 = 0 OR NOT EXISTS (SELECT 1 FROM lease @index(lease_live_by_worker)
        @join tile AS held ON held.id = lease.tile @join job AS mine ON mine.number = held.job
        WHERE lease.worker = ?2 AND lease.ended IS NULL
          AND (mine.submitter = share.submitter OR mine.priority > share.priority)))
 ORDER BY share.priority DESC, share.served_us, share.submitter LIMIT 1
