/* Ranks: processes that share one fit over MPI (`mpirun -n 2 oriel-train fit`, `srun`). Each holds all photos and the whole model; a step's rays and a round's photos are split over ranks x threads,
 * and what they found is summed in that order, so all ranks hold the same bits, those of one rank with as many threads. Only rank 0 writes files and progress.
 * ranks_mpi.c where mpicc was found at build time, else ranks.c: one rank, alone. So it is for a program started without a launcher. */
#ifndef TRAINER_RANKS_H
#define TRAINER_RANKS_H
#include <stddef.h>

enum { RANKS_MOST = 64 };

void ranks_start(void);
void ranks_end(void);
void ranks_fail(void);              /* this rank cannot go on: ends all of them with exit code 1. Returns where there is one only */
int  ranks_count(void);             /* 1 if alone */
int  ranks_here(void);              /* how many share this machine */
int  ranks_mine(void);              /* 0 .. ranks_count() - 1 */
/* All ranks call these in the same order. Nothing happens for one rank. */
void ranks_merge(void *bytes, size_t n);                /* each rank has filled its own part and zeros elsewhere: afterwards all have all parts */
void ranks_share(int from, void *bytes, size_t n);      /* all get what rank `from` has */
void ranks_send(int to, const void *bytes, size_t n);
void ranks_receive(int from, void *bytes, size_t n);
#endif
