"""Changes of the robot named while it drives, with probabilities, from gyro, wheels, temperature and clocks alone.

`monitor.Monitor` is fed with samples and answers with `findings.Finding`s. Its parts, in the order of the data:

- `rows`: samples become rows, the turn by the gyro and the wheels' distances over the same time, in blocks;
- `symptoms`: what a look at the readings shows by logic, before any regression;
- `library`: the sensitivity of each row to each effect, by the effect's own formula;
- `segments`: their products, summed over segments of time that grow longer with age;
- `evidence`: the likelihood of each effect since each segment, beside what robots do anyway;
- `constants`, `memory`, `wear`, `lasting`: what the robot has for long, by day, and what the days show;
- `fixes`: distances between poses that were set;
- `findings`, `monitor`: what is told, and the memory of it.

Equations (94) to (101). After Basseville and Nikiforov, Detection of Abrupt Changes (1993).
"""
