"""Changes of the robot named while it drives, with probabilities, from gyro, wheels, temperature and clocks alone.

`monitor.Monitor` is fed with samples and answers with `findings.Finding`s. Its parts, in the order of the data:

- `rows`: samples become rows, the turn by the gyro and the wheels' distances over the same time, in blocks;
- `symptoms`: faults that the readings show by logic, before any regression;
- `library`: the sensitivity of each row to each effect, by the effect's own formula;
- `segments`: their products, summed over segments of time that grow longer with age;
- `evidence`: the likelihood of each effect since each segment, besides the nuisance effects of every robot;
- `constants`, `memory`, `wear`, `lasting`: the robot's constants by day, and findings over days;
- `fixes`: distances between poses that were set;
- `findings`, `monitor`: the reported findings, and their history.

Equations (94) to (101). After Basseville and Nikiforov, Detection of Abrupt Changes (1993).
"""
