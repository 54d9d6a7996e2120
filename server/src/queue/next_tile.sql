SELECT frame, kind FROM tile
 WHERE job = ?4 AND state = 'ready' AND not_before_ms <= ?1 AND (avoid IS NULL OR avoid <> ?2 OR ?3)
 ORDER BY job, frame, position LIMIT 1
