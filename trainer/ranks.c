/* One rank (ranks.h): nothing to exchange. */
#include "trainer/ranks.h"

void ranks_start(void) { }
void ranks_end(void) { }
void ranks_fail(void) { }
int ranks_count(void) { return 1; }
int ranks_here(void) { return 1; }
int ranks_mine(void) { return 0; }
void ranks_merge(void *bytes, size_t n) { (void)bytes; (void)n; }
void ranks_share(int from, void *bytes, size_t n) { (void)from; (void)bytes; (void)n; }
void ranks_send(int to, const void *bytes, size_t n) { (void)to; (void)bytes; (void)n; }
void ranks_receive(int from, void *bytes, size_t n) { (void)from; (void)bytes; (void)n; }
