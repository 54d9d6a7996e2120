SELECT number, id, width_px, height_px, samples, pixel_bytes, edge_px, frames_total, frames_opened, nodes
 FROM job
 WHERE finished_at_ms IS NULL
   AND (nodes <= ?4 OR number IN (SELECT stitch.job FROM tile AS stitch
        WHERE stitch.state = 'ready' AND stitch.kind = 'stitch' AND stitch.not_before_ms <= ?1
          AND (stitch.avoid IS NULL OR stitch.avoid <> ?2 OR ?3 < 0)))
   AND (frames_opened < frames_total OR EXISTS (
        SELECT 1 FROM tile WHERE tile.job = job.number AND tile.state = 'ready' AND tile.not_before_ms <= ?1
           AND (tile.avoid IS NULL OR tile.avoid <> ?2 OR iif(tile.kind = 'stitch', 0, job.nodes) > ?3)))
 ORDER BY priority DESC, number LIMIT 1
