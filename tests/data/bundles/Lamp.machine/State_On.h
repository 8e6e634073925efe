//
// State_On.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class On: public CLState
            {
                class Transition_0: public CLTransition
                {
                public:
                    Transition_0(int toState = 1): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                class Transition_1: public CLTransition
                {
                public:
                    Transition_1(int toState = 4): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                CLTransition *_transitions[2];

                public:
                    On(const char *name = "On");

                    virtual int numberOfTransitions() const { return 2; }

#                   include "State_On_Variables.h"
            };
